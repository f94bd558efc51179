"""What of a situation outlives the process, as JSON values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from uav_mission_manager.mdp import StateSpace
from uav_mission_manager.onboard.battery import Batteries, Battery, BatteryReport
from uav_mission_manager.onboard.settling import Dangers, GoalRequest, Wish
from uav_mission_manager.onboard.situation import Situation

KEPT_TOPICS = frozenset({'threat_level', 'goal_priorities'})
"""Inputs whose last value stays in force however old it is, also over a restart."""


def situation_memory(situation: Situation) -> dict[str, Any]:
    """Return what another process cannot hear again. It changes only when an input does."""
    wish = situation.wish
    return {
        'cell': situation.cell,
        'dangers': sorted(situation.dangers.reported),
        'ended': dict(sorted(situation.dangers.ended.items())),
        'priorities': list(situation.priorities),
        'refused': list(situation.refused),
        'request': situation.request,
        'said': list(situation.said),
        'pending': wish.pending and [list(wish.pending.priorities), wish.pending.id],
        'changed_at': wish.changed_at if math.isfinite(wish.changed_at) else None,
        'commitment': situation.commitment,
        'agile': situation.agile,
        'known': sorted(situation.known & KEPT_TOPICS),
        'batteries': situation.batteries.memory,
    }


def remembered(situation: Situation, memory: Mapping[str, Any]) -> Situation:
    """Return a new situation with what an earlier process knew.

    Raises
    ------
    LookupError, TypeError, ValueError, AttributeError
        If it cannot be the memory of such a situation.
    """
    pending, changed_at = memory['pending'], memory['changed_at']
    known = replace(
        situation,
        batteries=Batteries.remembered(memory['batteries']),
        cell=memory['cell'],
        dangers=Dangers(
            frozenset(memory['dangers']),
            {name: float(time) for name, time in memory['ended'].items()},
        ),
        priorities=tuple(memory['priorities']),
        refused=tuple(map(bool, memory['refused'])),
        request=str(memory['request']),
        said=tuple(memory['said']),
        wish=Wish(
            None if pending is None else GoalRequest(tuple(pending[0]), str(pending[1])),
            -math.inf if changed_at is None else float(changed_at),
        ),
        commitment=memory['commitment'],
        agile=bool(memory['agile']),
        known=frozenset(memory['known']) & KEPT_TOPICS,
    )
    StateSpace.of(situation.mission).check(known.state)
    return known


def situation_now(situation: Situation) -> dict[str, Any]:
    """Return what its memory leaves out, as it is heard again within seconds."""
    return {
        'position': situation.position,
        'seen': dict(situation.seen),
        'time': situation.time,
        'batteries': {name: asdict(b) for name, b in situation.batteries.by_id.items()},
    }


def as_it_was(situation: Situation, now: Mapping[str, Any]) -> Situation:
    """Return a remembered situation with what `situation_now` said.

    Raises
    ------
    LookupError, TypeError, ValueError, AttributeError
        If that cannot be.
    """
    position = now['position']
    return replace(
        situation,
        position=None if position is None else tuple(position),
        seen=dict(now['seen']),
        time=float(now['time']),
        batteries=Batteries(
            {
                name: Battery(**{**battery, 'report': BatteryReport(**battery['report'])})
                for name, battery in now['batteries'].items()
            }
        ),
    )
