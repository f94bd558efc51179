"""The states that a policy flies through: its discounted occupancy, by simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.evaluation.simulation import Simulator


def start_state(mission: Mission) -> IntArray:
    """At base, all goals at high priority and in range, no fault, no threat: (1, 2k+5)."""
    k = mission.k
    return np.array([[1, *[1] * k, *[2] * k, mission.grid.base, 0, 0, 0]])


def starts_at_base(mission: Mission, count: int, rng: np.random.Generator) -> IntArray:
    """States at the start of a flight, shape (count, 2k+5).

    At base, nominal, every goal in range, no commitment, no threat, normal mode; priorities are
    drawn evenly.
    """
    space = StateSpace.of(mission)
    states = np.zeros((count, len(space.shape)), np.int64)
    s = space.split(states)
    s.f[:], s.r[:], s.l[:] = 1, 1, mission.grid.base
    s.g[:] = rng.integers(0, 3, s.g.shape)
    return states


def flown_states(
    mission: Mission,
    act: Callable[[IntArray], IntArray],
    count: int,
    rng: np.random.Generator,
    starts: IntArray | None = None,
) -> IntArray:
    """States drawn from the discounted occupancy of a policy, shape (count, 2k+5).

    Each is the state after T epochs of an episode of its own, P(T = n) = (1 - discount)
    discount^n. Hence a mean over them is (1 - discount) times the discounted sum over a flight.

    Parameters
    ----------
    mission : Mission
    act : callable
        The policy: action numbers (N,) of states (N, 2k+5).
    count : int
    rng : numpy.random.Generator
    starts : int array (count, 2k+5), optional
        Where the flights start; by default at base, see `starts_at_base`.
    """
    simulator = Simulator(mission)
    states = starts_at_base(mission, count, rng) if starts is None else starts.copy()
    left = rng.geometric(1 - mission.discount, count) - 1
    while (flying := np.flatnonzero(left > 0)).size:
        states[flying] = simulator.step(states[flying], act(states[flying]), rng)
        left[flying] -= 1
    return states
