"""Measures by which Algorithm 1 judges parts of a mission and clusters of goals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.mdp.dynamics import completion_probabilities, priority_matrices
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.routes import diameter, distances

MAX_PAIRWISE_CELLS = 64
"""Cells up to which all pairs are looked at; of more, pairs are counted by their offset: a
choice."""


@dataclass(frozen=True)
class Measures:
    """What Algorithm 1 judges candidates by, each measure within 0..1.

    Attributes
    ----------
    mission : Mission
    """

    mission: Mission

    @cached_property
    def worth(self) -> FloatArray:
        """What is at stake in each goal, omega_j = (eta_j + delta_j) u_j, shape (k,).

        u_j is the discounted share of epochs in which the goal is wanted, g_j > 0, if nobody
        completes it, over evenly drawn priorities at the start.
        """
        goals, discount = self.mission.goals, self.mission.discount
        matrices = priority_matrices(self.mission)
        wanted = np.array([[[0.0], [1.0], [1.0]]])
        visits = np.linalg.solve(np.eye(3) - discount * matrices, (1 - discount) * wanted)
        # Rounded: the last digits, which differ between machines, shall not decide a rank.
        shares = visits.mean(axis=(1, 2)).round(12)
        return np.array([goal.eta + goal.delta for goal in goals]) * shares

    @cached_property
    def coupling(self) -> FloatArray:
        """Reward coupling of two goals, shape (k, k), 0 on the diagonal.

        sqrt(omega_i omega_j) / max(omega) * (1 + d_ij / diameter) / 2: what one UAV that can
        serve only one of them at a time loses grows with what is at stake in both, and with the
        distance between them.
        """
        grid, cells = self.mission.grid, [goal.cell for goal in self.mission.goals]
        apart = np.array([distances(grid, cell)[cells] for cell in cells])
        detour = (1 + apart / (diameter(grid) or 1.0)) / 2
        relative = np.sqrt(self.worth / (self.worth.max() or 1.0))
        coupling = relative[:, None] * relative * detour
        np.fill_diagonal(coupling, 0.0)
        return coupling

    def closest(self, n: int) -> tuple[tuple[int, ...], ...]:
        """All clusters of n goals, from 0: those first whose least coupling within is largest."""
        names = [goal.name for goal in self.mission.goals]

        def rank(cluster: tuple[int, ...]) -> tuple[float, list[str]]:
            within = (self.coupling[pair] for pair in combinations(cluster, 2))
            return -min(within, default=np.inf), sorted(names[j] for j in cluster)

        return tuple(sorted(combinations(range(self.mission.k), n), key=rank))

    def reward_impact(self, goals: Iterable[int], cells: Iterable[int]) -> float:
        """Share of all worth that some goals carry which are sited in some cells."""
        sites, inside = [goal.cell for goal in self.mission.goals], set(cells)
        carried = math.fsum(self.worth[j] for j in goals if sites[j] in inside)
        return carried / (math.fsum(self.worth) or 1.0)

    def spatial_coherence(self, cells: Iterable[int]) -> float:
        """1 - mean distance between two different cells of these / diameter of the grid."""
        grid, chosen = self.mission.grid, np.unique(np.fromiter(cells, np.int64))
        pairs = len(chosen) * (len(chosen) - 1)
        total = summed_distances(grid, chosen)
        return 1 - total / ((pairs or 1) * (diameter(grid) or 1.0))

    def fault_sensitivity(self, goals: Iterable[int], faults: Iterable[int]) -> float:
        """How far completion C_j of some goals and cost phi are from nominal, at most.

        max_f max_j (|C_j(f) - C_j(1)| / max C_j + |phi(f) - phi(1)| / max phi) / 2.
        """
        chosen = np.ix_(list(goals), [f - 1 for f in faults])
        return float(self._fault_sensitivity[chosen].max())

    @cached_property
    def _fault_sensitivity(self) -> FloatArray:
        """`fault_sensitivity` of one goal and one fault mode, shape (k, 8)."""
        completion = completion_probabilities(self.mission)
        return (_from_nominal(completion) + _from_nominal(np.array(self.mission.faults.cost))) / 2


def _from_nominal(by_mode: FloatArray) -> FloatArray:
    """How far numbers (.., 8) are from that of nominal, f = 1, relative to the largest."""
    largest = by_mode.max(axis=-1, keepdims=True)
    return np.abs(by_mode - by_mode[..., :1]) / np.where(largest > 0, largest, 1.0)


def summed_distances(grid: Grid, cells: IntArray) -> float:
    """Sum of the distances of all ordered pairs of different cells, in cell widths."""
    if len(cells) <= MAX_PAIRWISE_CELLS:
        return float(sum(distances(grid, cell)[cells].sum() for cell in cells.tolist()))
    row, col = np.divmod(cells, grid.cols)
    height, width = int(np.ptp(row)) + 1, int(np.ptp(col)) + 1
    region = np.zeros((height, width))
    region[row - row.min(), col - col.min()] = 1
    # Its autocorrelation counts the pairs of cells by how far south and east they are apart.
    offsets = Grid(2 * height - 1, 2 * width - 1, 0, 0)
    shape = offsets.rows, offsets.cols
    spectrum = np.fft.rfft2(region, shape)
    counts = np.rint(np.fft.fftshift(np.fft.irfft2(np.abs(spectrum) ** 2, shape)))
    return float((counts.ravel() * distances(offsets, offsets.q // 2)).sum())
