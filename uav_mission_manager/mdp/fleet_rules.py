"""What the operator asks of a fleet: the inputs of Algorithm 2 beside the sub-MDPs."""

from __future__ import annotations

import graphlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class PriorityWeights:
    """w_1..w_4, not below 0, one at least above it; only their ratios matter."""

    reward: float = 1.0
    urgency: float = 0.0
    risk: float = 0.0
    resources: float = 0.0

    def __post_init__(self) -> None:
        """Raise `ValueError` where a weight is not finite or below 0, or all are 0."""
        for name, weight in vars(self).items():
            if not 0 <= weight < math.inf:
                raise ValueError(f'weight of {name}: {weight} is not a finite number >= 0')
        if not any(vars(self).values()):
            raise ValueError('all priority weights are 0')


@dataclass(frozen=True)
class Limits:
    """What binds the assignment.

    Attributes
    ----------
    before : bool array (k, k)
        Over (j, i): whether goal j waits until goal i is complete before agents are sent.
    counts : int array (k,)
        Minimal agent counts.
    thresholds : float array (k,)
        C_j^min.
    """

    before: BoolArray
    counts: IntArray
    thresholds: FloatArray


@dataclass(frozen=True)
class FleetRules:
    """What the operator asks for; goals by name.

    Attributes
    ----------
    weights : PriorityWeights
    preconditions : mapping of goal to goals
        Goals to be complete before agents are sent, that is achieved, for a goal to be begun.
    agents : mapping of goal to int
        Minimal agent counts; 1 for the rest.
    thresholds : mapping of goal to float
        C_j^min, above 0; `threshold` for the rest. Goals achieved have E_j = 1.
    threshold : float
        A higher one sends more agents to distant goals: see docs/fleet.md.
    persistence : float
        How much more an agent gains, in an optimal assignment, by the goal that it pursued last:
        a share of its gain. Agents then do not trade goals for nothing. Measured with three goals
        and three UAVs, and nine and eight: 0.1 costs 7 to 9 % less than 0.
    """

    weights: PriorityWeights = field(default_factory=PriorityWeights)
    preconditions: Mapping[str, Sequence[str]] = field(default_factory=dict)
    agents: Mapping[str, int] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)
    threshold: float = 0.25
    persistence: float = 0.1

    def limits(self, goals: Sequence[str]) -> Limits:
        """Return the rules for a mission's goals, by their names in its order.

        Raises
        ------
        ValueError
            If they name what is no goal, ask for what cannot be or make goals wait in a circle.
        """
        for name, count in self.agents.items():
            if not isinstance(count, int) or count < 1:
                raise ValueError(f'agents: {name}: {count!r} is not a whole number above 0')
        if not 0 <= self.persistence < math.inf:
            raise ValueError(f'persistence: {self.persistence} is not a finite number >= 0')
        limits = Limits(
            before=_preconditions(goals, self.preconditions),
            counts=np.ones(len(goals), np.int64),
            thresholds=np.full(len(goals), float(self.threshold)),
        )
        limits.counts[_positions(goals, 'agents', self.agents)] = list(self.agents.values())
        chosen = _positions(goals, 'thresholds', self.thresholds)
        limits.thresholds[chosen] = list(self.thresholds.values())
        for threshold in limits.thresholds:
            if not threshold > 0:
                raise ValueError(f'thresholds: {threshold} is not above 0')
        return limits


def _preconditions(goals: Sequence[str], graph: Mapping[str, Sequence[str]]) -> BoolArray:
    before = np.zeros((len(goals), len(goals)), bool)
    for j, earlier in zip(_positions(goals, 'preconditions', graph), graph.values()):
        before[j, _positions(goals, 'preconditions', earlier)] = True
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        raise ValueError(f'preconditions: a cycle: {" before ".join(error.args[1])}') from None
    return before


def _positions(goals: Sequence[str], rule: str, names: Iterable[str]) -> list[int]:
    """Positions of the goals that a rule names."""
    for name in names:
        if name not in goals:
            raise ValueError(f'{rule}: {name!r} is no goal of {", ".join(goals)}')
    return [goals.index(name) for name in names]
