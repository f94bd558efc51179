"""Dwell: a command stays for a while before the policy's next change of mind is flown.

A policy decides by the cell, and a vehicle on the border of two cells, or a fault found just
before it, would turn around and back. What is dangerous is never waited for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from uav_mission_manager.mdp import Action, action_name
from uav_mission_manager.onboard.situation import Situation
from uav_mission_manager.policy import Decision


@dataclass(frozen=True)
class StandingCommand:
    """The command in force.

    Attributes
    ----------
    action : Action
    since : float
        Time [s] at which it was first given.
    situation : Situation
        What it was last decided on.
    """

    action: Action
    since: float
    situation: Situation


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
        Time [s] for which a command stays, unless danger rises, the task changes, or the command
        has lost its sense.
    now : float
        Time [s].

    Returns
    -------
    Decision, StandingCommand
        While a command is kept, the runner-up is what the policy says, and the margin is what
        keeping costs, so below 0.
    """
    since = now
    if standing is not None:
        # A clock set back makes more time left than there was: it ends the wait.
        left = standing.since + seconds - now
        same = decision.action == standing.action
        if not same and 0.0 < left <= seconds and _may_stay(standing, decision, situation):
            decision, same = _kept(standing.action, decision, situation, left), True
        since = standing.since if same else now
    return decision, StandingCommand(decision.action, since, situation)


def _may_stay(standing: StandingCommand, decision: Decision, situation: Situation) -> bool:
    goal = standing.action.goal
    return (
        math.isfinite(decision.values[standing.action.number - 1])
        and (goal is None or bool(situation.priorities[goal] and situation.reachable[goal]))
        and situation.task == standing.situation.task
        and not _danger_rose(standing.situation, situation)
    )


def _danger_rose(before: Situation, now: Situation) -> bool:
    """Whether a part failed, the threat grew or a goal fell out of range."""
    new_faults = (now.fault - 1) & ~(before.fault - 1)  # One bit for each part, see FAULT_MODES.
    lost = any(was > is_now for was, is_now in zip(before.reachable, now.reachable))
    return bool(new_faults) or now.threat > before.threat or lost


def _kept(action: Action, decision: Decision, situation: Situation, left: float) -> Decision:
    kept, wanted = (action_name(situation.mission, a) for a in (action, decision.action))
    values = decision.values
    return replace(
        decision,
        action=action,
        runner_up=decision.action,
        margin=values[decision.action.number - 1] - values[action.number - 1],
        reason=(
            f'keeps {kept} for {left:.1f} s more; the policy now says {wanted}: {decision.reason}'
        ),
    )
