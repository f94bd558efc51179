"""The mission: every number the MDP is made of, as immutable data.

A mission file (see `uav_mission_manager.mdp.mission_file`) is read into these classes; nothing
else in the package holds model parameters.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from typing import Any, ClassVar

from uav_mission_manager.goal_task import GoalTask, task_to_dict
from uav_mission_manager.mdp.areas import Areas
from uav_mission_manager.mdp.energy import Energy, Range
from uav_mission_manager.mdp.fleet_rules import FleetRules
from uav_mission_manager.mdp.grid import Grid

Row = tuple[float, ...]
"""A row of numbers of a mission."""

Matrix = tuple[Row, ...]
"""A matrix of numbers of a mission, row by row."""

FAULT_MODES = (
    'nominal',
    'sensor',
    'actuator',
    'sensor_actuator',
    'camera',
    'sensor_camera',
    'actuator_camera',
    'all',
)
"""Names of f = 1..8: 1 + sensor + 2 actuator + 4 camera, each bit 1 when that part has failed."""

PRIORITY_LEVELS = ('no', 'low', 'high')
"""Priorities g in words."""

THREAT_LEVELS = ('none', 'low', 'high')
"""Names of t = 0, 1, 2."""


@dataclass(frozen=True)
class Goal:
    """A goal: where it is and what it costs to leave it undone.

    Attributes
    ----------
    name : str
        Unique, without white space.
    cell : int
        Grid cell.
    eta, delta : float
        Cost an epoch and unit of priority while the goal is in range but not committed to, and
        while it is out of range (the paper's eta_j and delta_j).
    priority_transition : tuple of 3 rows of 3
        P(g' | g); rows from 0 (achieved), 1 (low), 2 (high).
    task : GoalTask or None
        What is done there, None for what the bridge does at every goal. Needed to fly, not to
        plan.
    completion : tuple of 8, or None
        P(completed in one epoch on site | f); None for that of `Faults`.
    slot : bool
        Whether a goal that is requested in flight may take its place (`mdp.placing`).
    requested : int
        Priority that the goal in a slot was requested with; 0 for none.
    added : bool
        Whether it is a slot that the mission file has not. None of the three is a part of the
        decision process: missions that differ in nothing else are equal and have one digest.
    """

    name: str
    cell: int
    eta: float
    delta: float
    priority_transition: Matrix
    task: GoalTask | None = None
    completion: Row | None = None
    slot: bool = field(default=False, compare=False)
    requested: int = field(default=0, compare=False)
    added: bool = field(default=False, compare=False)


@dataclass(frozen=True)
class Parts:
    """A number for each part that can fail, from the lowest bit of f - 1 to the highest."""

    sensor: float
    actuator: float
    camera: float


@dataclass(frozen=True)
class Faults:
    """Failure, repair and what the fault mode f does to the mission.

    Attributes
    ----------
    rate, agile_factor : Parts
        Failure probability an epoch in normal flight, and its factor in agile flight.
    repair_success : float
        P(f' = 1) of one repair at the service cell.
    completion : tuple of 8
        P(goal completed in one epoch on site | f), of goals that have none of their own.
    cost : tuple of 8
        phi(f), cost an epoch.
    """

    rate: Parts
    agile_factor: Parts
    repair_success: float
    completion: Row
    cost: Row


@dataclass(frozen=True)
class Threat:
    """The threat level's Markov chain and its cost; a subclass may have other levels.

    Attributes
    ----------
    levels : tuple of str
        Names of t = 0, 1, ..
    onset : float
        P(t: 0 -> 1 or 2) an epoch in an ordinary cell.
    zones : tuple of (cell, onset)
        Cells with an onset of their own.
    high_share : float
        Share of onsets that are high.
    from_low, from_high : tuple of 3
        P(t' | t = 1) and P(t' | t = 2).
    cost : tuple of a row of 2 for each level
        p(t, m); columns normal, agile.

    Raises
    ------
    ValueError
        If there is not a row of `cost` for each level, or `transition` gives no probabilities.
    """

    levels: ClassVar[tuple[str, ...]] = THREAT_LEVELS
    onset: float
    zones: tuple[tuple[int, float], ...]
    high_share: float
    from_low: Row
    from_high: Row
    cost: Matrix

    def __post_init__(self) -> None:
        """Raise `ValueError` where the levels, their costs and their chain do not fit together."""
        count = len(self.levels)
        if len(self.cost) != count:
            names = ', '.join(self.levels)
            raise ValueError(f'threat.cost: {len(self.cost)} rows are not one each of {names}')
        for onset in {self.onset, *dict(self.zones).values()}:
            rows = self.transition(onset)
            if [len(row) for row in rows] != [count] * count:
                raise ValueError(f'threat.transition: not {count} rows of {count} numbers')
            for row in rows:
                if not (min(row) >= 0 and math.isclose(sum(row), 1)):
                    raise ValueError(f'threat.transition: {row} are no probabilities of sum 1')

    def transition(self, onset: float) -> Matrix:
        """P(t' | t), row by row, on arrival in a cell with this onset."""
        high = onset * self.high_share
        return (1 - onset, onset * (1 - self.high_share), high), self.from_low, self.from_high


@dataclass(frozen=True)
class ServiceCost:
    """Cost an epoch of recharge and of repair at the service cell."""

    recharge: float = 0.0
    repair: float = 0.0


@dataclass(frozen=True)
class Mission:
    """One UAV's mission with k goals.

    Attributes
    ----------
    feasibility : {'strict', 'paper'}
        Whether actions are allowed only where they make sense, or everywhere as in the paper.
    distance_weight : float
        Cost of a cell width between the UAV and its destination, an epoch.
    energy : Energy or None
        Needed on board, not to plan.
    extra_costs : tuple of 2k+4 rows of q
        Cost an epoch of each action in each cell, on top of the paper's h; none by default. A
        mission file has no such field.
    areas : Areas
        Fence and no-fly areas. No part of the decision process: missions that differ in nothing
        else are equal and have one digest.
    fleet : FleetRules
        What is asked of several UAVs that share the goals. No part of the decision process either.

    Raises
    ------
    ValueError
        If `extra_costs` have another shape, or one is below 0 or not finite, or there is a charge
        without `energy`.
    """

    name: str
    discount: float
    feasibility: str
    grid: Grid
    goals: tuple[Goal, ...]
    faults: Faults
    range: Range
    threat: Threat
    distance_weight: float
    service_cost: ServiceCost = ServiceCost()
    energy: Energy | None = None
    extra_costs: Matrix = ()
    areas: Areas = field(default=Areas(), compare=False)
    fleet: FleetRules = field(default=FleetRules(), compare=False)

    def __post_init__(self) -> None:
        """Raise `ValueError` where the extra costs, or a charge, cannot be used."""
        if self.range.charge is not None and self.energy is None:
            raise ValueError('range.charge: needs energy')
        actions, lengths = 2 * self.k + 4, {len(row) for row in self.extra_costs}
        if self.extra_costs and (len(self.extra_costs) != actions or lengths != {self.grid.q}):
            raise ValueError(f'extra_costs: not {actions} rows of {self.grid.q}')
        for cost in chain.from_iterable(self.extra_costs):
            if not 0 <= cost < math.inf:
                raise ValueError(f'extra_costs: {cost} is below 0 or not finite')

    @property
    def k(self) -> int:
        """Number of goals."""
        return len(self.goals)

    def geography(self) -> dict[str, Any]:
        """Return what a command means on the ground: weights may differ, these must not."""
        return {'goals': [(goal.name, goal.cell) for goal in self.goals], 'grid': self.grid}

    def to_dict(self) -> dict[str, Any]:
        """Return the mission in the mission file's schema; reading it gives an equal mission.

        Raises
        ------
        ValueError
            If the mission has what no mission file can say.
        """
        if self.extra_costs:
            raise ValueError(f'mission {self.name}: extra_costs: no mission file has them')
        if type(self.threat) is not Threat:
            kind = type(self.threat).__name__
            raise ValueError(f'mission {self.name}: threat: no mission file has a {kind}')
        data = asdict(self)
        del data['extra_costs']
        for entry, goal in zip(data['goals'], self.goals, strict=True):
            entry['task'] = goal.task and task_to_dict(goal.task)
            for key in ('task', 'completion', 'slot', 'requested', 'added'):
                if not entry[key]:
                    del entry[key]
        data['threat']['zones'] = {str(cell): onset for cell, onset in self.threat.zones}
        if self.grid.origin is None:
            del data['grid']['origin']
        data['grid']['elevation'] = {str(cell): up for cell, up in self.grid.elevation}
        if not self.grid.elevation:
            del data['grid']['elevation']
        if not self.grid.bearing:
            del data['grid']['bearing']
        data['range'] = _without_none(data['range'])
        if self.range.charge is not None:
            data['range']['charge'] = _without_none(data['range']['charge'])
        if self.energy is None:
            del data['energy']
        else:
            data['energy'] = _without_none(data['energy'])
        data['areas'] = {key: value for key, value in data['areas'].items() if value}
        if not data['areas']:
            del data['areas']
        if self.fleet == FleetRules():
            del data['fleet']
        return data

    def digest(self) -> str:
        """SHA-256 of the mission in canonical JSON, without areas, fleet, slots and tasks."""
        goals = tuple(
            replace(goal, task=None, slot=False, requested=0, added=False) for goal in self.goals
        )
        data = replace(self, goals=goals, areas=Areas(), fleet=FleetRules()).to_dict()
        text = json.dumps(data, sort_keys=True, separators=(',', ':'))
        return hashlib.sha256(text.encode()).hexdigest()


def _without_none(data: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if value is not None}
