"""Algorithm 1: factor-based decomposition of the mission into sub-MDPs.

Candidates are made goal by goal, by regions of the grid, by groups of fault modes and, mixed, by
merging goals that couple and by intersecting regions with fault modes. Those above T_max states
are discarded, and those that overlap too much with one of a higher score

    Score(M_i) = w_g RewardImpact(M_i) + w_l SpatialCoherence(M_i) + w_f FaultSensitivity(M_i).

What is left is the plan {M_1..M_N}, best first, and the map phi from states to 1..N.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy

from uav_mission_manager.mdp.arrays import IndexArray
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.mission import FAULT_MODES, Mission
from uav_mission_manager.solver.decomposition.measures import Measures
from uav_mission_manager.solver.decomposition.plan import Part, Plan, first_part
from uav_mission_manager.solver.submdp import sub_mdp_states

ALL_FAULT_MODES = tuple(range(1, len(FAULT_MODES) + 1))
"""f = 1..8."""

FAULT_GROUP_SIZES = (8, 4, 2, 1)
"""Fault modes in a group: all, camera healthy or failed, and so on by actuator and sensor."""

RANKING_DECIMALS = 12
"""Decimals of a part's measures: further ones, which differ between machines, rank nothing."""


def decompose(
    mission: Mission,
    max_states: int,
    kind: str = 'auto',
    *,
    weights: Sequence[float] = (1.0, 1.0, 1.0),
    overlap: float = 0.5,
    merge_score: float = 0.0,
    clusters: Sequence[tuple[tuple[int, ...], int]] | None = None,
) -> Plan:
    """Decompose a mission into sub-MDPs of at most `max_states` states (Algorithm 1).

    Parameters
    ----------
    mission : Mission
    max_states : int
        T_max.
    kind : {'goal', 'location', 'fault', 'clusters', 'blocks', 'auto'}
        Candidates: one a goal; the fewest regions of the grid, or groups of fault modes, that
        fit; goals, and each merged with those it couples with most; the fewest regions in groups
        of fault modes that fit; or all.
    weights : three floats
        w_g, w_l and w_f.
    overlap : float
        Jaccard index, of the goals x cells x fault modes covered, from which a part gives way
        to one of a higher score, unless nothing else covers a state.
    merge_score : float
        Score that merged goals must exceed.
    clusters : sequence of (goals, states), optional
        Candidates of kind 'clusters' in place of single and merged goals: their goals, from 0,
        and how many states the sub-MDPs have in which these are looked at.

    Raises
    ------
    ValueError
        If an argument is out of range, or the parts leave a state uncovered.
    """
    _check(max_states, kind, weights, overlap, merge_score)
    maker = _Candidates(mission, max_states, weights, merge_score)
    if kind == 'clusters' and clusters is not None:
        candidates = [maker.cluster(goals, states) for goals, states in clusters]
    else:
        candidates = [part for make in DECOMPOSITION_KINDS[kind] for part in make(maker)]
    parts = [part for part in candidates if part.states <= max_states]
    names = [goal.name for goal in mission.goals]
    parts.sort(
        key=lambda part: (
            -part.score,
            sorted(names[j] for j in part.goals),
            part.cells,
            part.faults,
        )
    )
    return Plan(mission, max_states, _without_overlap(mission, parts, overlap))


class _Candidates:
    """Makes the parts among which `decompose` chooses."""

    def __init__(
        self, mission: Mission, max_states: int, weights: Sequence[float], merge_score: float
    ) -> None:
        self.mission, self.max_states = mission, max_states
        self.weights, self.merge_score = weights, merge_score
        self.measures = Measures(mission)
        self.goals, self.cells = tuple(range(mission.k)), tuple(range(mission.grid.q))

    def single_goals(self) -> list[Part]:
        return [self._part('goal', (j,), self.cells, ALL_FAULT_MODES) for j in self.goals]

    def merged_goals(self) -> list[Part]:
        """Each goal with those that couple most with the ones it is already merged with."""
        coupling, goals = self.measures.coupling, self.mission.goals
        merged, largest = {}, _largest_cluster(self.mission, self.max_states)
        for cluster in ([j] for j in self.goals):
            for _ in range(1, largest):
                ranked = [
                    (-math.fsum(coupling[j, cluster]), goals[j].name, j)
                    for j in self.goals
                    if j not in cluster
                ]
                cluster.append(min(ranked)[-1])
                chosen = tuple(sorted(cluster))
                if chosen not in merged:
                    merged[chosen] = self._part('mixed', chosen, self.cells, ALL_FAULT_MODES)
        return [part for part in merged.values() if part.score > self.merge_score]

    def cluster(self, goals: tuple[int, ...], states: int) -> Part:
        """Goals looked at together, in less than full detail where that makes fewer states."""
        kind = 'goal' if len(goals) == 1 else 'mixed'
        part = self._part(kind, goals, self.cells, ALL_FAULT_MODES)
        return replace(part, states=states, cost=states * (2 * self.mission.k + 4))

    def locations(self) -> list[Part]:
        return self._blocks(8)

    def fault_groups(self) -> list[Part]:
        sizes = [size for size in FAULT_GROUP_SIZES if self._room(size) >= len(self.cells)]
        return self._blocks(sizes[0]) if sizes else []

    def fewest_blocks(self) -> list[Part]:
        return self._blocks(min(FAULT_GROUP_SIZES, key=self._count))

    def _room(self, modes: int) -> int:
        """Cells of the largest block with so many fault modes."""
        return self.max_states // sub_mdp_states(self.mission, len(self.goals), 1, modes)

    def _count(self, modes: int) -> float:
        """Number of blocks with so many fault modes."""
        room = self._room(modes)
        return 8 // modes * math.ceil(len(self.cells) / room) if room else math.inf

    def _blocks(self, modes: int) -> list[Part]:
        """Groups of so many fault modes times the fewest regions that fit."""
        room = self._room(modes)
        if not room:
            return []
        parts = []
        for cells in _regions(self.mission.grid, room):
            kind = 'location' if modes == 8 else 'fault' if room >= len(self.cells) else 'mixed'
            for first in range(0, 8, modes):
                faults = ALL_FAULT_MODES[first : first + modes]
                parts.append(self._part(kind, self.goals, cells, faults))
        return parts

    def _part(
        self, kind: str, goals: tuple[int, ...], cells: tuple[int, ...], faults: tuple[int, ...]
    ) -> Part:
        """A part that leaves goals out is as coherent as the cells its flights are between."""
        grid, measures = self.mission.grid, self.measures
        ends = [grid.base, grid.service, *(self.mission.goals[j].cell for j in goals)]
        measured = (
            measures.reward_impact(goals, cells),
            measures.spatial_coherence(cells if len(goals) == self.mission.k else ends),
            measures.fault_sensitivity(goals, faults),
            float(measures.coupling[np.ix_(goals, goals)].max()),
        )
        impact, coherence, sensitivity, coupling = (
            round(measure, RANKING_DECIMALS) for measure in measured
        )
        judged = zip(self.weights, (impact, coherence, sensitivity))
        states = sub_mdp_states(self.mission, len(goals), len(cells), len(faults))
        return Part(
            kind=kind,
            goals=goals,
            cells=cells,
            faults=faults,
            states=states,
            cost=states * (2 * len(goals) + 4),
            reward_impact=impact,
            spatial_coherence=coherence,
            fault_sensitivity=sensitivity,
            coupling=coupling,
            score=sum(weight * measure for weight, measure in judged),
        )


DECOMPOSITION_KINDS: dict[str, tuple[Callable[[_Candidates], list[Part]], ...]] = {
    'goal': (_Candidates.single_goals,),
    'location': (_Candidates.locations,),
    'fault': (_Candidates.fault_groups,),
    'clusters': (_Candidates.single_goals, _Candidates.merged_goals),
    'blocks': (_Candidates.fewest_blocks,),
    'auto': (
        _Candidates.single_goals,
        _Candidates.locations,
        _Candidates.fault_groups,
        _Candidates.merged_goals,
        _Candidates.fewest_blocks,
    ),
}
"""What proposes the sub-MDPs, by the kind of decomposition."""


def _check(
    max_states: int, kind: str, weights: Sequence[float], overlap: float, merge_score: float
) -> None:
    if max_states < 1:
        raise ValueError(f'max_states {max_states} must be above 0')
    if kind not in DECOMPOSITION_KINDS:
        raise ValueError(f'kind {kind!r} is none of {", ".join(DECOMPOSITION_KINDS)}')
    finite = len(weights) == 3 and all(0 <= weight < math.inf for weight in weights)
    if not finite or not any(weights):
        raise ValueError(f'weights {weights} must be three, finite, not negative, not all 0')
    if not 0 < overlap <= 1:
        raise ValueError(f'overlap {overlap} must be above 0 and at most 1')
    if not math.isfinite(merge_score):
        raise ValueError(f'merge_score {merge_score} is not finite')


def _largest_cluster(mission: Mission, max_states: int) -> int:
    """Goals of the largest cluster that fits, 0 if none does."""
    return sum(sub_mdp_states(mission, n) <= max_states for n in range(1, mission.k + 1))


def _regions(grid: Grid, room: int) -> list[tuple[int, ...]]:
    """Fewest regions of at most `room` cells: pieces of a path that winds through the grid.

    It runs to and fro along the shorter side, so the pieces are contiguous and compact.
    """
    lines = np.arange(grid.q).reshape(grid.rows, grid.cols)
    if grid.cols > grid.rows:
        lines = lines.T
    lines = lines.copy()
    lines[1::2] = lines[1::2, ::-1]
    pieces = np.array_split(lines.ravel(), math.ceil(grid.q / room))
    return [tuple(sorted(piece.tolist())) for piece in pieces]


def _without_overlap(mission: Mission, parts: Sequence[Part], overlap: float) -> tuple[Part, ...]:
    """Drop parts too much like a better one, unless they are needed to cover a state."""
    kept = np.zeros(len(parts), dtype=bool)
    for number, others in enumerate(_alike(mission, parts, overlap)):
        kept[number] = not kept[others].any()
    best = [part for part, keep in zip(parts, kept) if keep]
    covered = first_part(mission, best) <= len(best)
    for number, part in enumerate(parts):
        kept[number] |= not covered[part.box].all()
        covered[part.box] = True
    return tuple(part for part, keep in zip(parts, kept) if keep)


def _alike(mission: Mission, parts: Sequence[Part], overlap: float) -> list[IndexArray]:
    """The parts that each part overlaps with, by a Jaccard index of at least `overlap`."""
    regions = {cells: number for number, cells in enumerate({part.cells: 0 for part in parts})}
    inside = _members(list(regions), mission.grid.q)
    of_region = _members([(regions[part.cells],) for part in parts], len(regions))
    # Only pairs with cells in common are looked at: regions have no more than a few of them.
    shared = (of_region @ (inside @ inside.T) @ of_region.T).tocoo()
    one, other = shared.coords
    common = shared.data
    for chosen, size in (([p.goals for p in parts], mission.k), ([p.faults for p in parts], 9)):
        members = _members(chosen, size).toarray()
        common = common * (members[one] * members[other]).sum(axis=1)
    sizes = np.array([len(p.goals) * len(p.cells) * len(p.faults) for p in parts])
    alike = common / (sizes[one] + sizes[other] - common) >= overlap
    ends = np.cumsum(np.bincount(one[alike], minlength=len(parts)))
    return np.split(other[alike], ends[:-1])[: len(parts)]


def _members(sets: Sequence[Sequence[int]], size: int) -> scipy.sparse.csr_array:
    """1 where a number below `size` is in a set, shape (sets, size)."""
    ends = np.cumsum([0, *map(len, sets)])
    numbers = np.fromiter(itertools.chain.from_iterable(sets), np.int64)
    return scipy.sparse.csr_array(
        (np.ones(len(numbers), np.int64), numbers, ends), (len(sets), size)
    )
