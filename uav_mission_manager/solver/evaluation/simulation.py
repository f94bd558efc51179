"""Simulation of independent episodes of a mission, all stepped at once.

Costs, what is allowed and every draw come from `uav_mission_manager.mdp`, each variable from its
own matrix; nothing of the solver's arrays is used, and nothing grows with the number of states.

With a value function V' and Q'(s, a) = J(s, a) + discount E[V'(s') | s, a] as control variates
an episode's sample of V^pi(s_0) is V'(s_0) + sum_t discount^t (Q'(s_t, a_t) - V'(s_t)). It has
the mean V^pi(s_0) whatever V' is, since E[Q'(s_t, a_t)] = E[J_t + discount V'(s_{t+1})] and the
sum over V' telescopes; it varies the less the closer V' is to V^pi (Henderson and Glynn 2002).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from uav_mission_manager.mdp import dynamics
from uav_mission_manager.mdp.actions import global_actions
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.mdp.cost import StageCost, largest_stage_cost
from uav_mission_manager.mdp.feasibility import allowed_actions
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.greedy import choose


@dataclass(frozen=True)
class ControlVariate:
    """An approximate value function, and the Q values that look one epoch ahead in it.

    Attributes
    ----------
    values : callable
        V'(s) of states (N, 2k+5), shape (N,).
    q_values : callable
        J(s, a) + discount E[V'(s') | s, a] of states for all actions, shape (N, 2k+4).
    """

    values: Callable[[IntArray], FloatArray]
    q_values: Callable[[IntArray], FloatArray]


@dataclass(frozen=True)
class Estimate:
    """V^pi of M start states by simulation; arrays of shape (M,).

    Attributes
    ----------
    mean, error : float array
        Mean of the samples, cut at the horizon, and its standard error.
    lower, upper : float array
        Confidence bounds on V^pi, of whatever may follow the horizon too.
    horizon : int
        Epochs of an episode.
    """

    mean: FloatArray
    error: FloatArray
    lower: FloatArray
    upper: FloatArray
    horizon: int


class Transition(NamedTuple):
    """One epoch of N episodes.

    Attributes
    ----------
    states : int array (N, 2k+5)
        Before it.
    actions : int array (N,)
        Action numbers.
    completed : bool array (N, k)
        The goals that the UAV completes in it.
    after : int array (N, 2k+5)
        The next states.
    """

    states: IntArray
    actions: IntArray
    completed: BoolArray
    after: IntArray


class Simulator:
    """One epoch of a mission for many independent UAVs.

    However they act, an epoch draws as many random numbers, each for the same purpose.

    Attributes
    ----------
    mission : Mission
    space : StateSpace
    costs : StageCost
        J(s, a) of states (N, 2k+5) and action numbers (N,), shape (N,).
    """

    def __init__(self, mission: Mission) -> None:
        self.mission, self.space = mission, StateSpace.of(mission)
        self.costs = StageCost(mission)
        actions = global_actions(mission)
        self._goal = np.array([-1 if a.goal is None else a.goal for a in actions])
        self._commitment = np.array([action.commitment for action in actions])
        self._agile = np.array([int(action.agile) for action in actions])
        self._landings, self._regimes = dynamics.landings(mission), dynamics.regimes(mission)
        self._may_complete = dynamics.may_complete(mission)
        self._completion = dynamics.completion_probabilities(mission)
        self._faults = _cumulative(dynamics.fault_matrices(mission))
        self._ranges = _cumulative(dynamics.range_matrices(mission))
        self._charge = _cumulative(dynamics.charge_matrices(mission))
        self._priorities = _cumulative(dynamics.priority_matrices(mission))
        self._threat = _cumulative(dynamics.threat_matrices(mission))

    def check(self, states: IntArray, actions: IntArray) -> None:
        """Raise `ValueError` where there is no such action or it is not allowed."""
        known = (actions >= 1) & (actions <= len(self._goal))
        a = np.where(known, actions, 1) - 1
        allowed = known & allowed_actions(self.mission, states)[np.arange(len(states)), a]
        bad = np.flatnonzero(~allowed)
        if bad.size:
            raise ValueError(
                f'action {actions[bad[0]]} is not allowed in state {states[bad[0]].tolist()}'
            )

    def step(self, states: IntArray, actions: IntArray, rng: np.random.Generator) -> IntArray:
        """Draw the next states, shape (N, 2k+5)."""
        return self.transition(states, actions, rng).after

    def transition(
        self, states: IntArray, actions: IntArray, rng: np.random.Generator
    ) -> Transition:
        """Draw the next states and say what was completed."""
        after, completed = self.act(states, actions, rng)
        g = self.space.split(after).g
        g[:] = self.priorities(g, completed, rng)
        return Transition(states, actions, completed, after)

    def act(
        self, states: IntArray, actions: IntArray, rng: np.random.Generator
    ) -> tuple[IntArray, BoolArray]:
        """Draw what becomes of the UAVs themselves.

        Returns
        -------
        after : int array (N, 2k+5)
            The next states, but with the priorities at hand.
        completed : bool array (N, k)
            The goals that are completed in the epoch.
        """
        a, s, after = actions - 1, self.space.split(states), states.copy()
        regime, to = self._regimes[a, s.l], self.space.split(after)
        # Without a goal, -1, an action reads some row, and completes nothing all the same.
        completing = rng.random(len(a)) < self._completion[self._goal[a], s.f - 1]
        completing &= self._may_complete[a, s.l]
        to.f[:] = _draw(self._faults[regime, s.f - 1], rng) + 1
        to.r[:] = _draw(self._ranges[regime[:, None], s.r], rng)
        to.b[:] = _draw(self._charge[regime[:, None], s.b], rng)
        to.l[:] = self._landings[a, s.l]
        to.c[:] = np.where(completing, 0, self._commitment[a])
        to.t[:] = _draw(self._threat[to.l, s.t], rng)
        to.m[:] = self._agile[a]
        goals = self._goal[a, None] == np.arange(self.mission.k)
        return after, completing[:, None] & goals

    def priorities(self, g: IntArray, completed: BoolArray, rng: np.random.Generator) -> IntArray:
        """Draw the next priorities of all goals, each 0 where it is completed, shape (N, k)."""
        drawn = _draw(self._priorities[np.arange(self.mission.k), g], rng)
        return np.where(completed, 0, drawn)


def simulate(
    mission: Mission,
    act: Callable[[IntArray], IntArray] | None,
    start: ArrayLike,
    epochs: int,
    rng: np.random.Generator,
    control: ControlVariate | None = None,
    watch: Callable[[Transition], None] | None = None,
) -> tuple[FloatArray, IntArray]:
    """Fly one episode from each start state.

    Parameters
    ----------
    mission : Mission
    act : callable, or None
        The policy: action numbers (N,) of states (N, 2k+5). None is the one of least Q in the
        control variate.
    start : int array (N, 2k+5)
    epochs : int
    rng : numpy.random.Generator
    control : ControlVariate, optional
    watch : callable, optional
        Is shown every epoch.

    Returns
    -------
    samples : float array (N,)
        Discounted costs, or with a control variate samples of the same mean when run for ever.
    states : int array (N, 2k+5)
        States after the last epoch.

    Raises
    ------
    StateError, ValueError
        If a start state is out of range, or an action is not allowed where it is chosen.
    """
    if act is None and control is None:
        raise ValueError('neither act nor control says what to do')
    simulator = Simulator(mission)
    states = simulator.space.check(start)
    samples, weight = np.zeros(len(states)), 1.0
    if control is not None:
        samples += control.values(states)
    for _ in range(epochs):
        q = np.empty((0, 0)) if control is None else control.q_values(states)
        actions = choose(q) if act is None else np.asarray(act(states))
        simulator.check(states, actions)
        if control is None:
            samples += weight * simulator.costs(states, actions)
        else:
            chosen = q[np.arange(len(states)), actions - 1]
            samples += weight * (chosen - control.values(states))
        epoch = simulator.transition(states, actions, rng)
        if watch is not None:
            watch(epoch)
        states = epoch.after
        weight *= mission.discount
    return samples, states


def cost_horizon(mission: Mission, truncation: float) -> int:
    """Return the least number of epochs T with discount^T <= truncation."""
    return math.ceil(math.log(truncation) / math.log(mission.discount))


def most_cost_after(mission: Mission, epochs: int) -> float:
    """Bound from above on the discounted costs after some epochs; they are nowhere below 0."""
    return mission.discount**epochs * largest_stage_cost(mission) / (1 - mission.discount)


def estimate(
    mission: Mission,
    act: Callable[[IntArray], IntArray] | None,
    start: ArrayLike,
    episodes: int,
    rng: np.random.Generator,
    control: ControlVariate | None = None,
    *,
    truncation: float = 1e-6,
    confidence: float = 0.99,
) -> Estimate:
    """Estimate V^pi of start states.

    Where the horizon T cuts an episode, what is left of V^pi lies in 0..discount^T J_max /
    (1 - discount), of which the samples hold discount^T V'(s_T). The bounds take it at its least
    and its most, so only the mean's distribution, taken as normal, is left to chance.

    Parameters
    ----------
    mission, act, rng, control
        See `simulate`.
    start : int array (M, 2k+5)
    episodes : int
        For each start state.
    truncation : float
        Largest discount^T.
    confidence : float
        Probability with which each start state's V^pi lies within its bounds.

    Raises
    ------
    ValueError
        If episodes is below 2, truncation or confidence not between 0 and 1; see `simulate` too.
    """
    if episodes < 2:
        raise ValueError(f'episodes {episodes} is below 2')
    if not (0 < truncation < 1 and 0 < confidence < 1):
        raise ValueError(
            f'truncation {truncation} and confidence {confidence} must be between 0 and 1'
        )
    rows = np.repeat(np.atleast_2d(np.asarray(start)), episodes, axis=0)
    horizon = cost_horizon(mission, truncation)
    samples, states = simulate(mission, act, rows, horizon, rng, control)
    most = most_cost_after(mission, horizon)
    held = 0.0 if control is None else mission.discount**horizon * control.values(states)
    quantile = float(scipy.special.stdtrit(episodes - 1, (1 + confidence) / 2))
    mean, error = _mean(samples, episodes)
    least, least_error = _mean(samples - held, episodes)
    return Estimate(
        mean=mean,
        error=error,
        lower=least - quantile * least_error,
        upper=least + most + quantile * least_error,
        horizon=horizon,
    )


def _mean(samples: FloatArray, episodes: int) -> tuple[FloatArray, FloatArray]:
    """Mean of each start state's samples and its standard error."""
    table = samples.reshape(-1, episodes)
    return table.mean(axis=1), table.std(axis=1, ddof=1) / math.sqrt(episodes)


def _cumulative(matrices: FloatArray) -> FloatArray:
    """P(x' <= i | x) for all i but the last, of transition matrices (..., n), (..., n - 1)."""
    sums = np.cumsum(matrices, axis=-1)
    # Divided, so that it is 1, not nearly, from the last x' that is possible.
    return np.asarray(sums[..., :-1] / sums[..., -1:])


def _draw(cumulative: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw x' from 0 from rows of `_cumulative`."""
    return np.asarray((rng.random(cumulative.shape[:-1])[..., None] >= cumulative).sum(axis=-1))
