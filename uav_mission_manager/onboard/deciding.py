"""The decision in a situation, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

from uav_mission_manager.mdp import ActionKind
from uav_mission_manager.onboard.situation import Situation
from uav_mission_manager.policy import Decision, Policy


@dataclass(frozen=True)
class Refusal:
    """No decision, and why."""

    reason: str


def decide(policy: Policy, situation: Situation, now: float, timeout: float) -> Decision | Refusal:
    """Return the policy's decision, or a refusal where what it needs is not known.

    In the model recharging brings every goal back into range, but it brings no refused one back:
    where it has no other use, the policy decides as if the refused goals were not wanted, and the
    decision's values are those of that state.

    Parameters
    ----------
    policy : Policy
    situation : Situation
    now : float
        Time [s], on the clock of the situation's inputs.
    timeout : float
        Age [s] above which an input counts as missing.
    """
    missing = situation.missing(now, timeout)
    if missing:
        return Refusal('link lost: ' + ', '.join(missing))
    decision = policy.decide(situation.state)
    refused = ', '.join(situation.refused_goals)
    if refused and decision.action.kind is ActionKind.RECHARGE and all(situation.in_range):
        decision = policy.decide(without_refused(situation).state)
        reason = f'as if {refused}, refused, were not wanted: {decision.reason}'
        return replace(decision, state=situation.state, reason=reason)
    return decision


def without_refused(situation: Situation) -> Situation:
    """Return the same situation, with refused goals not wanted instead of out of range."""
    wanted = zip(situation.priorities, situation.refused)
    priorities = tuple(0 if refused else g for g, refused in wanted)
    return replace(situation, priorities=priorities, refused=())
