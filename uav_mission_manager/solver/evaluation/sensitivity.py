"""How much V* changes with each number of the mission.

With P the transitions of the optimal policy, W as in `uav_mission_manager.solver.reduced` and T'
the backup of W in the changed mission,

    W'* - W* = (I - discount P)^-1 (T' W* - W*)        to first order,

for what the change makes of the policy is of second order (Danskin 1967). So there are two ways:
solve each changed mission anew, from V*; or make one backup of each, and average its change over
the states that the optimal policy flies through, the discounted occupancy.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.mission_file import mission_from_dict
from uav_mission_manager.solver.evaluation.occupancy import flown_states
from uav_mission_manager.solver.exact import AxisModel, Solution, Sweeper, value_iteration
from uav_mission_manager.solver.progress import Progress, Report, ignore
from uav_mission_manager.solver.submdp import whole_mission
from uav_mission_manager.solver.threads import processors

STEP = 0.1
"""Relative change of each parameter: a choice, about what a guess is wrong by at the least."""

SOLVE_TOLERANCE = 1e-6
"""Largest error of each solution, relative to V*: far below what a change makes of it."""

FieldPath = tuple[str | int, ...]
"""Keys and positions that lead to a number in a mission's document."""

_COSTS = ('eta', 'delta', 'cost', 'empty_cost', 'distance_weight', 'service_cost')
_FACTORS = ('agile_factor',)
_PROBABILITIES = ('rate', 'completion', 'repair_success', 'loss', 'onset', 'zones', 'high_share')
_DISTRIBUTIONS = ('priority_transition', 'from_low', 'from_high', 'drain')
_STAYS: dict[FieldPath, int] = {('from_low',): 1, ('from_high',): 2}


@dataclass(frozen=True)
class Parameter:
    """A number of the mission, and the mission in which it is another.

    Attributes
    ----------
    name : str
        The field, such as `threat.cost.2.0`, as errors name it; of what all goals have alike
        `priority_transition`.
    value, changed : float
        Before and after.
    mission : Mission
        With it changed.
    """

    name: str
    value: float
    changed: float
    mission: Mission


@dataclass(frozen=True)
class Sensitivity:
    """Relative change of V* at the start when one parameter is changed, all else kept."""

    name: str
    value: float
    changed: float
    relative: float


def parameters(mission: Mission) -> list[Parameter]:
    """Every number of the mission that V* may depend on, each changed by `STEP`.

    Costs and factors are raised by 10 %, probabilities too, but lowered where they would be
    above 1; the rest of a row of probabilities is scaled. Of the discount the horizon
    1 / (1 - discount) is raised. Numbers that are 0 have no relative change and are left out.
    """
    document = json.loads(json.dumps(mission.to_dict()))
    found = [_longer_horizon(document)]
    alike = len({goal.priority_transition for goal in mission.goals}) == 1
    all_own = all(goal.completion is not None for goal in mission.goals)
    for path in _numbers(document):
        if all_own and path[:2] == ('faults', 'completion'):
            continue
        shared = alike and path[0] == 'goals' and path[2] == 'priority_transition'
        if shared and path[1] != 0:
            continue
        places = [('goals', j, *path[2:]) for j in range(mission.k)] if shared else [path]
        name = '.'.join(map(str, path[2:] if shared else path))
        found.append(_changed(document, places, name))
    return found


def _longer_horizon(document: dict[str, Any]) -> Parameter:
    discount = document['discount']
    longer = 1 - (1 - discount) / (1 + STEP)
    changed = mission_from_dict(document | {'discount': longer}, 'sensitivity')
    return Parameter('discount', discount, longer, changed)


def _numbers(node: Any, path: FieldPath = ()) -> Iterator[FieldPath]:
    """Paths to the numbers above 0 that a solution depends on; of a row all but the diagonal."""
    if isinstance(node, (dict, list)):
        if node == [1.0]:  # The drain of a battery that lasts for ever.
            return
        entries = node.items() if isinstance(node, dict) else enumerate(node)
        for key, entry in entries:
            yield from _numbers(entry, (*path, key))
    elif isinstance(node, float) and node > 0:
        known = {*_COSTS, *_FACTORS, *_PROBABILITIES, *_DISTRIBUTIONS}
        if known & set(map(str, path)) and not _is_rest(path):
            yield path


def _is_rest(path: FieldPath) -> bool:
    """Whether a probability is what the others of its row leave: that of no change."""
    field = path[-2:-1]
    if path[-3:-2] == ('priority_transition',):
        return field == path[-1:]
    return field in _STAYS and path[-1] == _STAYS[field]


def _changed(document: dict[str, Any], places: Sequence[FieldPath], name: str) -> Parameter:
    """The mission with the number changed at each of these places, where it is the same."""
    document = json.loads(json.dumps(document))
    for path in places:
        *above, last = path
        node: Any = document
        for key in above:
            node = node[key]
        value = node[last]
        if set(_DISTRIBUTIONS) & set(map(str, path)):
            changed = _step_within_1(value)
            node[:] = _rest(node, value, changed)
        else:
            probable = set(_PROBABILITIES) & set(map(str, path))
            changed = _step_within_1(value) if probable else value * (1 + STEP)
        node[last] = changed
    return Parameter(name, value, changed, mission_from_dict(document, 'sensitivity'))


def _rest(row: list[float], value: float, changed: float) -> list[float]:
    """Scale a row for the other probabilities to make up for one that is changed."""
    if value == 1:
        return [(1 - changed) / (len(row) - 1)] * len(row)
    return [p * (1 - changed) / (1 - value) for p in row]


def _step_within_1(value: float) -> float:
    return value * (1 + STEP) if value * (1 + STEP) <= 1 else value * (1 - STEP)


def by_solving(
    solution: Solution, start: IntArray, progress: Progress = ignore
) -> list[Sensitivity]:
    """Sensitivities at a start state (1, 2k+5): every changed mission is solved from W*."""
    mission, value = solution.sub.mission, _value(solution, start)

    def change(parameter: Parameter) -> float:
        sub = whole_mission(parameter.mission)
        tolerance = SOLVE_TOLERANCE * max(abs(value), np.finfo(float).tiny)
        again = value_iteration(
            sub, tolerance, precision='double', start=(0, solution.value.astype(np.float64))
        )
        return _value(again, start) - value

    return _each(mission, value, change, progress)


def by_occupancy(
    solution: Solution,
    act: Callable[[IntArray], IntArray],
    start: IntArray,
    count: int,
    progress: Progress = ignore,
) -> list[Sensitivity]:
    """Sensitivities at a start state (1, 2k+5) to first order, by one backup of each mission.

    Parameters
    ----------
    solution : Solution
    act : callable
        The optimal policy: action numbers (N,) of states (N, 2k+5).
    start : int array (1, 2k+5)
    count : int
        States that are drawn from the policy's occupancy.
    """
    mission, value = solution.sub.mission, _value(solution, start)
    starts = np.repeat(start, count, axis=0)
    flown = flown_states(mission, act, count, np.random.default_rng(0), starts)
    weight, model, old = 1 / (1 - mission.discount), AxisModel(solution.sub), solution.value
    at = model.locate(flown)

    def change(parameter: Parameter) -> float:
        """Of W by its backup, and of V - W at the start itself."""
        changed = AxisModel(whole_mission(parameter.mission))
        own = changed.state_values(old, start) - model.state_values(old, start)
        sweeper = Sweeper(changed, old.astype(np.float64), processors())
        sweeper.backup()
        return float(own[0] + (sweeper.values[at] - old[at]).mean() * weight)

    return _each(mission, value, change, progress)


def _value(solution: Solution, start: IntArray) -> float:
    return float(AxisModel(solution.sub).state_values(solution.value, start)[0])


def _each(
    mission: Mission, value: float, change: Callable[[Parameter], float], progress: Progress
) -> list[Sensitivity]:
    """Sensitivities to all parameters, the largest first; none where V* is 0."""
    found, every = [], parameters(mission) if value else []
    for done, p in enumerate(every, 1):
        found.append(Sensitivity(p.name, p.value, p.changed, change(p) / value))
        progress(Report(done, done / len(every), p.name))
    return sorted(found, key=lambda sensitivity: -abs(sensitivity.relative))
