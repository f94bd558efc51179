"""Epochs that were flown, in a simulation or by a vehicle: what is counted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uav_mission_manager.mdp import Mission, StateSpace, dynamics
from uav_mission_manager.mdp.arrays import BoolArray, IntArray
from uav_mission_manager.solver.evaluation.simulation import Transition


class FlownEpochs(NamedTuple):
    """N epochs, of one flight or of many.

    Attributes
    ----------
    states : int array (N, 2k+5)
        Before each.
    actions : int array (N,)
        Action numbers.
    completed : bool array (N, k)
        The goals that were completed in it.
    after : int array (N, 2k+5)
        The next states.
    airborne : bool array (N,)
        Whether it was flown: where not, nothing can fail and no range is lost.
    """

    states: IntArray
    actions: IntArray
    completed: BoolArray
    after: IntArray
    airborne: BoolArray


def simulated_epochs(mission: Mission, epoch: Transition) -> FlownEpochs:
    """Return an epoch of simulated UAVs, in the air wherever the model has them there."""
    cells = StateSpace.of(mission).split(epoch.states).l
    regime = dynamics.regimes(mission)[epoch.actions - 1, cells]
    return FlownEpochs(*epoch, ~np.isin(regime, dynamics.ON_GROUND))


def joined(parts: Sequence[FlownEpochs]) -> FlownEpochs:
    """Return the epochs of several flights as one."""
    return FlownEpochs(*(np.concatenate(arrays) for arrays in zip(*parts)))
