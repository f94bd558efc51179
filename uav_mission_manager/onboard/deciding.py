"""The decision in a situation, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

from uav_mission_manager.mdp import ActionKind
from uav_mission_manager.onboard.inputs import silence
from uav_mission_manager.onboard.range_model import FULL_PACK
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
    decision's values are those of that state. A charge that is as full as it gets is not waited
    for: then the policy decides as if it were full.

    Parameters
    ----------
    policy : Policy
    situation : Situation
    now : float
        Time [s], on the clock of the situation's inputs.
    timeout : float
        Age [s] above which an input counts as missing.
    """
    if why := silence(situation.ages(now), timeout):
        return Refusal(why)
    decision = policy.decide(situation.state)
    recharges = decision.action.kind is ActionKind.RECHARGE
    if recharges and situation.mission.range.charge is not None:
        if not _full(situation):
            return decision
        decision = policy.decide(replace(situation, level=-1).state)
        reason = f'as if full, it holds no more: {decision.reason}'
        return replace(decision, state=situation.state, reason=reason)
    refused = ', '.join(situation.refused_goals)
    if refused and recharges and all(situation.in_range):
        decision = policy.decide(without_refused(situation).state)
        reason = f'as if {refused}, refused, were not wanted: {decision.reason}'
        return replace(decision, state=situation.state, reason=reason)
    return decision


def _full(situation: Situation) -> bool:
    """Whether the battery that counts holds about as much as it can."""
    energy = situation.mission.energy
    assert energy is not None
    battery = situation.batteries.worst(energy)
    return battery is not None and (battery.charge(energy) >= FULL_PACK * battery.share(energy))


def without_refused(situation: Situation) -> Situation:
    """Return the same situation, with refused goals not wanted instead of out of range."""
    wanted = zip(situation.priorities, situation.refused)
    priorities = tuple(0 if refused else g for g, refused in wanted)
    return replace(situation, priorities=priorities, refused=())
