"""Dwell: a command stays for a while before the policy's next change of mind is flown.

A policy decides by the cell, and a vehicle on the border of two cells, or a fault found just
before it, would turn around and back. What is dangerous is never waited for; whatever follows
waits the longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from uav_mission_manager.mdp import Action, action_name
from uav_mission_manager.onboard.situation import Situation
from uav_mission_manager.policy import Decision

MOST_WAITS = 2.0
"""Longest wait, in times the usual one, after a change that did not wait itself: a choice. With
two, who flies to and fro for a danger that comes and goes changes no more often than others."""


@dataclass(frozen=True)
class StandingCommand:
    """The command in force.

    Attributes
    ----------
    action : Action
    until : float
        Time [s] until which it stays, unless something is wrong with that.
    dangers : set of str
        Dangers that counted when it was last decided on.
    wanted : bool
        Whether any goal was wanted then.
    """

    action: Action
    until: float
    dangers: frozenset[str]
    wanted: bool


def dwell(
    decision: Decision,
    situation: Situation,
    standing: StandingCommand | None,
    seconds: float,
    now: float,
) -> tuple[Decision, StandingCommand]:
    """Return what to command, and the command that is then in force.

    Parameters
    ----------
    decision : Decision
        What the policy says now.
    situation : Situation
        What it was decided on.
    standing : StandingCommand or None
        The command in force; None where any command may be given at once.
    seconds : float
        Time [s] for which a command stays, unless danger rises, nothing is wanted any more,
        something is again, or the command has lost its sense.
    now : float
        Time [s].

    Returns
    -------
    Decision, StandingCommand
        While a command is kept, the runner-up is what the policy says, and the margin is what
        keeping costs, so below 0.
    """
    # Of a time farther ahead the clock has been set back since: the vehicle was switched off.
    until = now if standing is None else min(standing.until, now + MOST_WAITS * seconds)
    if standing is None or decision.action != standing.action:
        if standing is not None and until > now and _may_stay(standing, decision, situation):
            why = f'{until - now:.1f} s more; the policy now says'
            decision = _kept(standing.action, decision, situation, why)
        else:
            until = min(max(until, now) + seconds, now + MOST_WAITS * seconds)
    counted, wanted = situation.dangers.counted, any(situation.priorities)
    return decision, StandingCommand(decision.action, until, counted, wanted)


def stay(
    decision: Decision, situation: Situation, standing: StandingCommand | None
) -> Decision | None:
    """Return the command in force where the place is not one to decide on, None if none may stay.

    A vehicle that strays goes on: it is not taken to be anywhere else than it is.
    """
    if standing is None or not _may_stay(standing, decision, situation):
        return None
    if decision.action == standing.action:
        return replace(decision, reason=f'{situation.off_grid}: {decision.reason}')
    why = f'want of a place, {situation.off_grid}; in the nearest cell the policy says'
    return _kept(standing.action, decision, situation, why)


def _may_stay(standing: StandingCommand, decision: Decision, situation: Situation) -> bool:
    goal = standing.action.goal
    return (
        math.isfinite(decision.values[standing.action.number - 1])
        and (goal is None or bool(situation.priorities[goal] and situation.reachable[goal]))
        and any(situation.priorities) == standing.wanted
        and situation.dangers.counted <= standing.dangers
    )


def _kept(action: Action, decision: Decision, situation: Situation, why: str) -> Decision:
    kept, wanted = (action_name(situation.mission, a) for a in (action, decision.action))
    values = decision.values
    return replace(
        decision,
        action=action,
        runner_up=decision.action,
        margin=values[decision.action.number - 1] - values[action.number - 1],
        reason=f'keeps {kept} for {why} {wanted}: {decision.reason}',
    )
