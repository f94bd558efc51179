"""Ascent on the costs that clusters of goals shift among each other.

psi_i(y, a) is shifted between all clusters, psi_i(y, x_j, a) between those that share goal j, and
psi_i(y, x_j, x_l, a) between those that share goals j and l; y = (l, t, f), x_j = (g_j, r_j). The
sum of the clusters' V_i, averaged over states, is concave in psi, and greatest where clusters
agree on how often what they share occurs: on their *occupancies* rho_i(y, a), rho_i(y, x_j, a),
rho_i(y, x_j, x_l, a). With a soft minimum of temperature tau, adding tau log(rho_i / mean rho) to
psi_i would make them agree if the distribution of states stayed the same (Sinkhorn 1967). Since
it follows, a part of that is taken in each step, while tau falls and V_i and rho_i follow psi by
one sweep. What the fewer variables tell is taken out of log rho first, as in a log-linear model,
so that a disagreement is met once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, RealArray
from uav_mission_manager.solver.bounds.cluster_mdp import (
    ClusterMdp,
    Slots,
    Terms,
    swept_values,
)
from uav_mission_manager.solver.reduced import X_VALUES
from uav_mission_manager.solver.submdp import SubMdp
from uav_mission_manager.solver.threads import share

T = TypeVar('T')

SHARED_GOALS = 2
"""Most goals that psi depends on."""

STEPS = 4.0, 12.0, 12.0
"""Part of the agreeing psi taken in a step, in (1 - discount), by the number of goals that psi
depends on. Measured on the case study with three, five and ten goals: a smaller part for psi(y, a)
or larger ones for the rest make the bound of ten goals worse, twice the first part changes little.
"""

FIRST_TEMPERATURE = 0.12
"""Of the soft minimum, in the mean cost of an epoch over the clusters that hold a goal. Measured
as `STEPS` were: within a factor of two it matters little, four times as much or a quarter cost
one per cent of the bound of ten goals."""

COOLING = 1 / 80
"""Last temperature over the first."""

RARE = 1e-6
"""What is added to occupancies, of which a state's is 1 on average."""

PSI_UNIT = 2.0**-24
"""Of the mean cost of an epoch: psi is rounded to multiples of it, so that its sums are exact."""

START_TOLERANCE = 1e-2
"""Distance from its bounds, relative to the largest, of the W that the ascent starts from."""

Goals = tuple[int, ...]
"""Goals that clusters share, ascending; none for what all clusters share."""


class Ascent:
    """Clusters with their W, occupancies and psi in single precision.

    Parameters
    ----------
    subs : sequence of SubMdp
        At least two clusters, whose costs add up to the mission's.
    unit : float
        What costs are divided by, a power of two.
    threads : int

    Attributes
    ----------
    values, occupancies : list of float32 array (q, 6^n, 8 T)
        In the end W is near its optimum under psi, see `settled`.
    mean : float
        Of all states, of the sum of the clusters' W under the even split.
    """

    def __init__(self, subs: Sequence[SubMdp], unit: float, threads: int) -> None:
        self.unit, self.threads, self.rest = unit, threads, 1 - subs[0].mission.discount
        self.mdps = [ClusterMdp(sub, np.float32, unit) for sub in subs]
        self.holders = shared_goals([sub.goals for sub in subs])
        self.shared = [
            [goals for goals in self.holders if set(goals) <= set(sub.goals)] for sub in subs
        ]
        self.occupancies: list[RealArray] = [np.ones(mdp.shape, np.float32) for mdp in self.mdps]
        # psi is what a cluster has gathered less the mean over those that share it.
        self.means: dict[Goals, RealArray] = {goals: self._zeros(goals) for goals in self.holders}
        self.gathered = [{goals: self._zeros(goals) for goals in here} for here in self.shared]
        self.values = each(self._start, len(subs), threads)
        self.mean = sum(float(values.mean(dtype=float)) for values in self.values)
        holders = np.bincount(np.concatenate([sub.goals for sub in subs]))
        self.warm = FIRST_TEMPERATURE * self.rest * self.mean / holders.mean()

    @property
    def possible(self) -> bool:
        """Whether anything is shared, and costs enough for single precision to tell."""
        return len(self.mdps) > 1 and self.warm * COOLING > np.finfo(np.float32).tiny / RARE

    def _zeros(self, goals: Goals) -> RealArray:
        q, actions, rest = self.mdps[0].shape[0], self.mdps[0].axes[0], self.mdps[0].axes[-1]
        return np.zeros((q, actions, *(X_VALUES,) * len(goals), rest), np.float32)

    def _start(self, cluster: int) -> RealArray:
        mdp = self.mdps[cluster]
        zero, costs = np.zeros(mdp.shape, np.float32), mdp.costs({})
        first, bounds = mdp.sweep(zero, costs)
        tolerance = START_TOLERANCE * bounds.gain * float(np.abs(first).max())
        values, bounds = swept_values(mdp, costs, first, tolerance)
        return np.asarray(values + np.float32(bounds.lowest))

    def climb(self, done: float) -> None:
        """Take one step, after a part of all."""
        tau = self.warm * COOLING**done
        each(lambda cluster: self._visit(cluster, tau), len(self.mdps), self.threads)
        share(lambda thread, goals: self._average(goals), list(self.holders), self.threads)

    def _average(self, goals: Goals) -> None:
        mean, holders = self.means[goals], self.holders[goals]
        mean[:] = 0
        for cluster in holders:
            mean += self.gathered[cluster][goals]
        mean /= np.float32(len(holders))

    def _visit(self, cluster: int, tau: float) -> None:
        """Sweep a cluster's W and occupancy, and gather what disagrees with the others'."""
        gathered = self.gathered[cluster]
        marginals = self._sweep(cluster, self._present(cluster), np.float32(tau))
        for goals, part in zip(gathered, _disagreements(marginals)):
            step = min(STEPS[len(goals)] * self.rest, 1.0) * tau
            gathered[goals] += np.float32(step) * part.reshape(gathered[goals].shape)

    def _sweep(self, cluster: int, psi: Terms, tau: np.float32) -> Terms:
        """Sweep with a soft minimum; return the occupancies of what psi depends on."""
        mdp, values, occupancy = (
            self.mdps[cluster],
            self.values[cluster],
            self.occupancies[cluster],
        )
        costs = [cost * (-1 / tau) for cost in mdp.costs(psi)]
        ahead = mdp.ahead(values) * (-1 / tau)
        arrived = np.zeros_like(ahead)
        marginals = {slots: np.empty_like(term) for slots, term in psi.items()}
        for cell in range(len(values)):
            q = mdp.q_values(cell, ahead, costs)
            largest = q.max(axis=0)
            q -= largest
            np.exp(q, out=q)
            total = q.sum(axis=0)
            soft = largest + np.log(total)
            values[cell] = -tau * soft.reshape(values[cell].shape)
            q *= occupancy[cell].reshape(total.shape) / total
            mdp.leave(cell, q, arrived)
            _marginals(q, marginals, cell)
        values += mdp.state_costs
        self.occupancies[cluster] = np.float32(self.rest) + mdp.settle(arrived)
        return marginals

    def _present(self, cluster: int) -> Terms:
        """Psi of a cluster as it is now."""
        psi: dict[Goals, RealArray] = {}
        for goals, gathered in self.gathered[cluster].items():
            psi[goals] = gathered - self.means[goals]
        return self._terms(cluster, psi)

    def settled(self, cluster: int, tolerance: float) -> FloatArray:
        """W of a cluster under psi, as near as single precision lets it come or a tolerance."""
        mdp = self.mdps[cluster]
        costs = mdp.costs(self._present(cluster))
        values, bounds = swept_values(mdp, costs, self.values[cluster], tolerance / self.unit)
        return self.unit * (values.astype(np.float64) + bounds.lowest)

    def _terms(self, cluster: int, psi: dict[Goals, RealArray]) -> Terms:
        """Psi of some goals as terms of a cluster's costs."""
        mdp, terms = self.mdps[cluster], {}
        for goals, table in psi.items():
            slots = tuple(map(mdp.sub.goals.index, goals))
            terms[slots] = table.reshape(mdp.term_shape(slots))
        return terms

    def psi(self, cluster: int) -> Terms:
        """Psi as multiples of its unit, exactly zero in sum over the clusters that share it."""
        found: dict[Goals, RealArray] = {}
        for goals in self.shared[cluster]:
            *others, last = self.holders[goals]
            if cluster != last:
                psi = self._rounded(cluster, goals)
            else:
                psi = -np.sum([self._rounded(other, goals) for other in others], axis=0)
            found[goals] = psi * self.unit
        return self._terms(cluster, found)

    def _rounded(self, cluster: int, goals: Goals) -> FloatArray:
        psi = self.gathered[cluster][goals] - self.means[goals]
        grid = math.ldexp(PSI_UNIT, math.frexp(self.rest * self.mean)[1])
        return np.asarray(grid * np.round(psi.astype(np.float64) / grid))


def each(work: Callable[[int], T], count: int, threads: int) -> list[T]:
    """Results of work(0), .., work(count - 1) in their order."""

    def numbered(thread: int, item: int) -> tuple[int, T]:
        return item, work(item)

    found = dict(share(numbered, range(count), threads))
    return [found[item] for item in range(count)]


def shared_goals(clusters: Sequence[Goals]) -> dict[Goals, list[int]]:
    """Sets of at most two goals that clusters share, and the clusters that do."""
    holders: dict[Goals, list[int]] = {}
    for size in range(SHARED_GOALS + 1):
        for cluster, goals in enumerate(clusters):
            for shared in itertools.combinations(goals, size):
                holders.setdefault(shared, []).append(cluster)
    return {goals: found for goals, found in holders.items() if len(found) > 1}


def _marginals(q: RealArray, into: Terms, cell: int) -> None:
    """Write the sums of a cell's table (A, 6, .., 6, 8 T) over all goals but some."""
    found: dict[Slots, RealArray] = {tuple(range(q.ndim - 2)): q}
    for slots in sorted(into, key=len, reverse=True):
        larger = min((other for other in found if set(slots) <= set(other)), key=len)
        axes = tuple(1 + slot for slot in larger if slot not in slots)
        found[slots] = found[larger].sum(axis=axes, keepdims=True)
        into[slots][cell] = found[slots]


def _disagreements(marginals: Terms) -> list[RealArray]:
    """Logarithms of occupancies less what those of fewer goals tell."""
    for table in marginals.values():
        table += np.float32(RARE)
        np.log(table, out=table)
    for slots in sorted(marginals, key=len):
        for fewer in marginals:
            if set(fewer) < set(slots):
                marginals[slots] -= marginals[fewer]
    return list(marginals.values())
