"""What happened how often in flown epochs, and out of how many.

Given the state and the action the next state does not depend on who chose the action, or why. So
counts by state and action are without bias whatever policy was flown, as long as an epoch is
counted or left out for what was so before it. What cannot be seen is left out:

- A goal can be completed only in an epoch that is committed to it in its cell, so only these
  count. Where it is completed, what the base station would have done with it is not seen.
- A part can fail only while it is whole and in flight, and a goal can fall out of range only while
  it is in range and in flight.
- A charge below the drains that are told apart hides how much was drained.
- What ends a recording is not in it. An epoch without an end is not counted.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from uav_mission_manager.learning.epochs import FlownEpochs
from uav_mission_manager.mdp import Mission, StateSpace, dynamics, global_actions
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray

PART_BITS = 3
"""Parts that can fail: bit i of f - 1 is part i of `Parts`."""


@dataclass(frozen=True)
class Counts:
    """Numbers of epochs; an axis of two for yes and no has what happened first.

    Attributes
    ----------
    priority : float array (k, 3, 3)
        By goal, priority before and after, of goals that were not completed.
    onset : float array (q, 3)
        By cell after the epoch and threat level after, with no threat before.
    threat : float array (3, 3)
        By threat level before and after, in any cell.
    failure : float array (2, 3, 2)
        By mode of flight and part that was whole: whether it failed.
    lost : float array (2, 2)
        By mode of flight, of each goal in range: whether it fell out of range.
    drain : float array (2, levels)
        By mode of flight and levels drained.
    completion : float array (k, 8, 2)
        By goal and fault mode, of epochs committed to it in its cell: whether it was completed.
    repair : float array (2,)
        Of repairs at the service cell: whether all is well after.
    """

    priority: FloatArray
    onset: FloatArray
    threat: FloatArray
    failure: FloatArray
    lost: FloatArray
    drain: FloatArray
    completion: FloatArray
    repair: FloatArray

    def __add__(self, other: Counts) -> Counts:
        """Return the counts of both."""
        names = [field.name for field in fields(self)]
        return Counts(*(getattr(self, name) + getattr(other, name) for name in names))


def count(mission: Mission, epochs: FlownEpochs) -> Counts:
    """Count what happened in flown epochs of a mission."""
    space = StateSpace.of(mission)
    before, after = space.split(epochs.states), space.split(epochs.after)
    agile = np.array([int(a.agile) for a in global_actions(mission)])[epochs.actions - 1]
    flown, repairs = epochs.airborne, _repairs(mission, epochs, before.l) & (before.f > 1)
    onset, threat = np.zeros((mission.grid.q, 3)), np.zeros((3, 3))
    calm = before.t == 0
    np.add.at(onset, (after.l[calm], after.t[calm]), 1)
    np.add.at(threat, (before.t, after.t), 1)
    whole = flown[:, None] & ~_failed(before.f)
    reached = flown[:, None] & (before.r == 1)
    return Counts(
        priority=_priorities(mission, before.g, after.g, epochs.completed),
        onset=onset,
        threat=threat,
        failure=np.stack(
            [_yes_no(_failed(after.f), whole & (agile == m)[:, None]) for m in (0, 1)]
        ),
        lost=np.stack(
            [_yes_no(after.r == 0, reached & (agile == m)[:, None]).sum(axis=0) for m in (0, 1)]
        ),
        drain=_drains(mission, before.b, after.b, agile, flown),
        completion=_completions(mission, epochs, before.f, before.l),
        repair=_yes_no((after.f == 1)[:, None], repairs[:, None])[0],
    )


def _yes_no(happened: BoolArray, possible: BoolArray) -> FloatArray:
    """Count each column of what happened, and did not, where it was possible: (columns, 2)."""
    yes = (possible & happened).sum(axis=0)
    return np.stack([yes, possible.sum(axis=0) - yes], axis=-1).astype(float)


def _failed(f: IntArray) -> BoolArray:
    return np.asarray(((f[:, None] - 1) >> np.arange(PART_BITS)) & 1, bool)


def _repairs(mission: Mission, epochs: FlownEpochs, cells: IntArray) -> BoolArray:
    regimes = dynamics.regimes(mission)
    return np.asarray(regimes[epochs.actions - 1, cells] == dynamics.Regime.REPAIRED)


def _priorities(
    mission: Mission, before: IntArray, after: IntArray, completed: BoolArray
) -> FloatArray:
    out = np.zeros((mission.k, 3, 3))
    row, goal = np.nonzero(~completed)
    np.add.at(out, (goal, before[row, goal], after[row, goal]), 1)
    return out


def _drains(
    mission: Mission, before: IntArray, after: IntArray, agile: IntArray, flown: BoolArray
) -> FloatArray:
    """Count drains from levels that are higher than any drain that the mission knows of."""
    out = np.zeros((2, mission.range.levels))
    if mission.range.charge is None:
        return out
    drain = mission.range.charge.drain
    known = max(len(drain.normal), len(drain.agile))
    told = flown & (before[:, 0] >= known)
    drained = np.maximum(before - after, 0)[told, 0]
    np.add.at(out, (agile[told], drained), 1)
    return out


def _completions(
    mission: Mission, epochs: FlownEpochs, f: IntArray, cells: IntArray
) -> FloatArray:
    """Count completions, and epochs on site without.

    On board a goal may be done before the first whole epoch on site is over: it counts as done,
    in no more epochs than were there.
    """
    on_site = dynamics.may_complete(mission)[epochs.actions - 1, cells]
    goals = np.array([a.commitment - 1 for a in global_actions(mission)])[epochs.actions - 1]
    tried, done = np.zeros((mission.k, 8)), np.zeros((mission.k, 8))
    np.add.at(tried, (goals[on_site], f[on_site] - 1), 1)
    row, goal = np.nonzero(epochs.completed)
    np.add.at(done, (goal, f[row] - 1), 1)
    return np.stack([done, np.maximum(tried - done, 0)], axis=-1)
