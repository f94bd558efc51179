"""What happens in simulated flights: when goals are done, how the time is spent, what fails.

A goal is done when the UAV completes it for the first time, and withdrawn when its priority falls
to 0 before, by the base station's doing. Times are counted in epochs; an epoch at the service
cell that recharges is a recharge, and one that repairs is a repair, whether it succeeds or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp import Mission, StateSpace, dynamics
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.solver.evaluation.simulation import (
    Transition,
    cost_horizon,
    most_cost_after,
    simulate,
)

NEGLIGIBLE_DISCOUNT = 1e-6
"""Weight of the first epoch whose cost is no longer simulated: a choice."""

MOST_EPOCHS = 20_000
"""Epochs of an episode, at most: a choice, a few minutes of computing. The interval of a cost
that takes longer to fade away is wider."""


@dataclass(frozen=True)
class Flights:
    """N simulated flights of a policy in a mission.

    Attributes
    ----------
    mission : Mission
    epochs : int
        Epochs in which anything but the cost was watched.
    done : int array (N, k)
        The epoch, from 1, at whose end a goal was done for the first time; 0 where it was not.
    withdrawn : bool array (N, k)
        Whether a goal was withdrawn before it was done, if it was.
    regime_epochs : int array (N, 5)
        Epochs spent in each `Regime`.
    fault_modes : bool array (N, 8)
        Whether each fault mode was ever met, at the start too.
    longest_flight : int array (N,)
        Most epochs in the air from one recharge, or the start, to the next.
    costs : float array (N,)
        Discounted costs, cut where they are no longer simulated.
    cost_left : float
        What was cut off is within 0 and this.
    """

    mission: Mission
    epochs: int
    done: IntArray
    withdrawn: BoolArray
    regime_epochs: IntArray
    fault_modes: BoolArray
    longest_flight: IntArray
    costs: FloatArray
    cost_left: float


class FlightLog:
    """Watches a simulation epoch by epoch, see `Flights`."""

    def __init__(self, mission: Mission, start: IntArray, epochs: int) -> None:
        self._space, self._left, self._epoch = StateSpace.of(mission), epochs, 0
        self._regimes, self._rows = dynamics.regimes(mission), np.arange(len(start))
        self.done = np.zeros((len(start), mission.k), np.int64)
        self.withdrawn = np.zeros(self.done.shape, bool)
        self.regime_epochs = np.zeros((len(start), len(dynamics.Regime)), np.int64)
        self.fault_modes = np.zeros((len(start), 8), bool)
        self._flown = np.zeros(len(start), np.int64)
        self.longest_flight = self._flown.copy()
        self._note_faults(start)

    def __call__(self, epoch: Transition) -> None:
        """Take note of one epoch; of those after the last, of nothing."""
        if self._epoch == self._left:
            return
        self._epoch += 1
        before, after = self._space.split(epoch.states), self._space.split(epoch.after)
        open_ = self.done == 0
        self.withdrawn |= open_ & (before.g > 0) & (after.g == 0) & ~epoch.completed
        self.done[open_ & epoch.completed] = self._epoch
        regime = self._regimes[epoch.actions - 1, before.l]
        self.regime_epochs[self._rows, regime] += 1
        self._flown += ~np.isin(regime, dynamics.ON_GROUND)
        self._flown[regime == dynamics.Regime.RECHARGED] = 0
        np.maximum(self.longest_flight, self._flown, out=self.longest_flight)
        self._note_faults(epoch.after)

    def _note_faults(self, states: IntArray) -> None:
        self.fault_modes[self._rows, self._space.split(states).f - 1] = True


def fly(
    mission: Mission,
    act: Callable[[IntArray], IntArray],
    start: ArrayLike,
    epochs: int,
    rng: np.random.Generator,
    tick: Callable[[float], None] = lambda _: None,
) -> Flights:
    """Simulate flights, one from each start state.

    Of generators in the same state, policies meet with the same luck.

    Parameters
    ----------
    mission : Mission
    act : callable
        The policy: action numbers (N,) of states (N, 2k+5).
    start : int array (N, 2k+5)
    epochs : int
        Epochs to watch; costs are simulated until they are negligible.
    rng : numpy.random.Generator
    tick : callable, optional
        Is told the share that is simulated, epoch by epoch.

    Raises
    ------
    StateError, ValueError
        If a start state is out of range, or an action is not allowed where it is chosen.
    """
    states = StateSpace.of(mission).check(start)
    horizon = max(epochs, min(cost_horizon(mission, NEGLIGIBLE_DISCOUNT), MOST_EPOCHS))
    log, passed = FlightLog(mission, states, epochs), 0

    def watch(epoch: Transition) -> None:
        nonlocal passed
        log(epoch)
        passed += 1
        tick(passed / horizon)

    costs, _ = simulate(mission, act, states, horizon, rng, watch=watch)
    return Flights(
        mission=mission,
        epochs=epochs,
        done=log.done,
        withdrawn=log.withdrawn,
        regime_epochs=log.regime_epochs,
        fault_modes=log.fault_modes,
        longest_flight=log.longest_flight,
        costs=costs,
        cost_left=most_cost_after(mission, horizon),
    )
