"""Simulation of independent episodes of a mission, all stepped at once.

Every variable is drawn from its own matrix of `uav_mission_manager.mdp.dynamics`; nothing of the
solver's arrays is used, and nothing grows with the number of states.

With a value function V' and Q'(s, a) = J(s, a) + discount E[V'(s') | s, a] as control variates
an episode's sample of V^pi(s_0) is V'(s_0) + sum_t discount^t (Q'(s_t, a_t) - V'(s_t)). It has
the mean V^pi(s_0) whatever V' is, since E[Q'(s_t, a_t)] = E[J_t + discount V'(s_{t+1})] and the
sum over V' telescopes; it varies the less the closer V' is to V^pi (Henderson and Glynn 2002).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from uav_mission_manager.mdp.actions import global_actions
from uav_mission_manager.mdp.dynamics import (
    failure_matrices,
    priority_matrices,
    range_matrix,
    threat_matrices,
)
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.recombination.rules import choose

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


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


class Simulator:
    """One epoch of a mission for many independent UAVs."""

    def __init__(self, mission: Mission) -> None:
        self.mission, self.space = mission, StateSpace(mission.k, mission.grid.q)
        actions = global_actions(mission)
        self._kind = np.array([action.kind for action in actions])
        self._goal = np.array([action.goal for action in actions])
        self._agile = np.array([action.agile for action in actions]).astype(int)
        self._destination = np.array([action.destination for action in actions])
        self._cells = np.array([goal.cell for goal in mission.goals])
        self._hops, self._distances = mission.grid.next_hops(), mission.grid.distances()
        modes = (False, True)
        self._failure = np.array([[p[0, 1] for p in failure_matrices(mission, m)] for m in modes])
        self._loss = np.array([range_matrix(mission, m)[1, 0] for m in modes])
        self._priority = _cumulative(np.stack(priority_matrices(mission)))
        self._threat = _cumulative(threat_matrices(mission))
        self._completion = np.array(mission.faults.completion)

    def costs(self, states: IntArray, actions: IntArray) -> FloatArray:
        """J(s, a) of states (N, 2k+5) and action numbers (N,), shape (N,)."""
        mission, (f, r, g, cell, c, t, m) = self.mission, self._split(states)
        eta = np.array([goal.eta for goal in mission.goals])
        delta = np.array([goal.delta for goal in mission.goals])
        waiting = c[:, None] != np.arange(1, mission.k + 1)
        goals = eta * g * r * waiting + (delta * g + mission.range.cost / mission.k) * (1 - r)
        a = actions - 1
        cost = goals.sum(axis=1) + np.array(mission.faults.cost)[f - 1]
        cost += np.array(mission.threat.cost)[t, m]
        cost += mission.distance_weight * self._distances[cell, self._destination[a]]
        for kind, price in vars(mission.service_cost).items():
            cost += price * ((self._kind[a] == kind) & (cell == mission.grid.service))
        return cost

    @property
    def largest_cost(self) -> float:
        """Bound on J(s, a) from above; it is nowhere below 0."""
        mission = self.mission
        lost = mission.range.cost / mission.k
        goals = sum(max(2 * goal.eta, 2 * goal.delta + lost) for goal in mission.goals)
        way = mission.distance_weight * self._distances.max()
        service = max(vars(mission.service_cost).values())
        threat = np.max(mission.threat.cost)
        return float(goals + way + service + max(mission.faults.cost) + threat)

    def check(self, states: IntArray, actions: IntArray) -> None:
        """Raise `ValueError` where there is no such action or it is not allowed."""
        f, r, g, *_ = self._split(states)
        known = (actions >= 1) & (actions <= len(self._kind))
        a = np.where(known, actions, 1) - 1
        kind, j, row = self._kind[a], self._goal[a] - 1, np.arange(len(states))
        allowed = (g[row, j] > 0) & (r[row, j] == 1) & (self._completion[f - 1] > 0)
        allowed = np.where(kind == 'recharge', (r == 0).any(axis=1), allowed)
        allowed = np.where(kind == 'repair', f > 1, allowed)
        allowed |= (kind == 'none') | (self.mission.feasibility == 'seed')
        bad = np.flatnonzero(~(known & allowed))
        if bad.size:
            raise ValueError(
                f'action {actions[bad[0]]} is not allowed in state {states[bad[0]].tolist()}'
            )

    def step(self, states: IntArray, actions: IntArray, rng: np.random.Generator) -> IntArray:
        """Draw the next states, shape (N, 2k+5)."""
        mission, (f, r, g, cell, c, t, _) = self.mission, self._split(states)
        grid, a, n = mission.grid, actions - 1, len(states)
        agile, after = self._agile[a], self._hops[cell, self._destination[a]]
        kind, serviced = self._kind[a], cell == grid.service
        resting = (kind == 'none') & (agile == 0) & (cell == grid.base)
        recharging, repairing = serviced & (kind == 'recharge'), serviced & (kind == 'repair')
        flying = ~(resting | recharging | repairing)[:, None]
        bits = f[:, None] - 1 >> np.arange(3) & 1
        bits |= flying & (rng.random((n, 3)) < self._failure[agile])
        repaired = repairing & (rng.random(n) < mission.faults.repair_success)
        r_next = r & ~(flying & (rng.random(r.shape) < self._loss[agile][:, None]))
        g_next = _draw(self._priority[np.arange(mission.k), g], rng)
        completed = (c > 0) & (cell == self._cells[c - 1])
        completed &= rng.random(n) < self._completion[f - 1]
        g_next[completed, c[completed] - 1] = 0
        return np.column_stack(
            [
                np.where(repaired, 1, 1 + bits @ [1, 2, 4]),
                np.where(recharging[:, None], 1, r_next),
                g_next,
                after,
                np.where(completed, 0, self._goal[a]),
                _draw(self._threat[after, t], rng),
                agile,
            ]
        )

    def _split(self, states: IntArray) -> tuple[IntArray, ...]:
        """Variables f, r (N, k), g (N, k), l, c, t, m."""
        k = self.mission.k
        return states[:, 0], states[:, 1 : 1 + k], states[:, 1 + k : 1 + 2 * k], *states.T[-4:]


def simulate(
    mission: Mission,
    act: Callable[[IntArray], IntArray] | None,
    start: ArrayLike,
    epochs: int,
    rng: np.random.Generator,
    control: ControlVariate | None = None,
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
        states = simulator.step(states, actions, rng)
        weight *= mission.discount
    return samples, states


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
    horizon = math.ceil(math.log(truncation) / math.log(mission.discount))
    samples, states = simulate(mission, act, rows, horizon, rng, control)
    weight = mission.discount**horizon
    most = weight * Simulator(mission).largest_cost / (1 - mission.discount)
    held = 0.0 if control is None else weight * control.values(states)
    quantile = float(stdtrit(episodes - 1, (1 + confidence) / 2))
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
    """P(x' <= 0) and P(x' <= 1) of rows of three probabilities, shape (..., 2)."""
    sums = np.cumsum(matrices, axis=-1)
    return sums[..., :2] / sums[..., 2:]  # 1, not nearly, where x' = 2 is impossible.


def _draw(cumulative: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw x' in 0..2 from rows of `_cumulative`."""
    return (rng.random(cumulative.shape[:-1])[..., None] >= cumulative).sum(axis=-1)
