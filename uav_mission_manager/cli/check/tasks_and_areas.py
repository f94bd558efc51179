"""What does not fit between a mission's tasks, the time at goals, the battery, and its areas."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib.util import find_spec

from uav_mission_manager.cli.check.facts import duration_text, goal_facts
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.limits import LIMITS
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.range_model import endurance
from uav_mission_manager.solver.evaluation.forecast import epoch_length


def area_findings(mission: Mission) -> Iterator[Finding]:
    """Warn of what lies in a no-fly area, or outside the fence."""
    areas = mission.areas
    if areas.fence is None and not areas.no_fly:
        return
    if find_spec('shapely') is None:
        text = "are not checked: that needs shapely, pip install '.[plan]'"
        yield Finding('areas', len(areas.no_fly), text, note=True)
        return
    from uav_mission_manager.cli.check.clearance import breaches

    yield from breaches(mission, {})


def task_findings(mission: Mission) -> Iterator[Finding]:
    """Warn of tasks that take another time than the model believes, and of long ones."""
    if mission.energy is None:
        return
    epoch, lasts = epoch_length(mission), endurance(mission.energy, 1.0)
    limit, told = LIMITS['task time'], set[str]()
    for number, (goal, facts) in enumerate(zip(mission.goals, goal_facts(mission), strict=True)):
        done, taken = facts.done_seconds, facts.task_seconds
        if done is None or math.isinf(done):
            continue
        where = f'goals.{number}' if goal.completion else 'faults'
        if lasts < done and where not in told:
            told.add(where)
            text = f'a full battery lasts {duration_text(lasts)}, so that it takes several flights'
            yield Finding(f'{where}.done_in (completion)', f'{done:.0f} s', text, note=True)
        if goal.task is None or taken is None or limit.hold(max(taken, epoch) / done):
            continue
        text = f'takes about {taken:.0f} s, {where}.done_in (completion) says {done:.0f} s'
        instead = f'give the goal done_in: {math.ceil(max(taken, epoch))}'
        yield Finding(f'goals.{number}.task', goal.name, f'{text}: {instead}')
