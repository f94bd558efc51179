"""What is known of the goals of a mission that takes another one's place in flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.placing import changed_goals

if TYPE_CHECKING:
    from uav_mission_manager.onboard.situation import Situation


def goals_of(
    mission: Mission, situation: Situation, dangers: Sequence[str], wanted: bool
) -> dict[str, Any]:
    """Return what a situation knows of the goals of another mission, by attribute.

    A goal that is new is in range until that is known better, and was not refused. Nobody is
    committed to it. All others stay as they are.

    Parameters
    ----------
    mission : Mission
    situation : Situation
    dangers : sequence of str
        Name of each goal's danger to be out of range.
    wanted : bool
        Whether new goals have the priority that they were requested with, or none.

    Raises
    ------
    ValueError
        If the mission cannot follow, see `changed_goals`.
    """
    new = changed_goals(situation.mission, mission)
    asked = {j: mission.goals[j].requested if wanted else 0 for j in new}

    further = mission.k - situation.mission.k
    refused = (*situation.refused, *(False,) * further)

    def renewed(priorities: tuple[int, ...]) -> tuple[int, ...]:
        known = *priorities, *(0,) * further
        return tuple(asked.get(j, g) for j, g in enumerate(known))

    pending = situation.wish.pending
    pending = pending and replace(pending, priorities=renewed(pending.priorities))
    return {
        'dangers': situation.dangers.without({dangers[j] for j in new if j < len(dangers)}),
        'priorities': renewed(situation.priorities),
        'refused': tuple(was and j not in asked for j, was in enumerate(refused)),
        # What the base station says of the slot is about the goal that was there.
        'said': tuple(0 if j in asked else g for j, g in enumerate(situation.said)),
        'wish': replace(situation.wish, pending=pending),
        'commitment': 0 if situation.commitment - 1 in asked else situation.commitment,
    }
