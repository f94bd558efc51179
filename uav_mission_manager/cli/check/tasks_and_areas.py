"""What does not fit between a mission's tasks, the time that they take, and its areas."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

from uav_mission_manager.cli.check.facts import epoch_seconds, goal_times
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.limits import LIMITS
from uav_mission_manager.cli.tasks import mean_seconds
from uav_mission_manager.mdp import Mission


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
    """Warn of tasks that take another time than the model believes.

    Where the mean of all goals is right that is a note: the model has one time for all.
    """
    epoch, completion = epoch_seconds(mission), mission.faults.completion[0]
    if epoch is None or completion == 0.0:
        return
    done, times, limit = epoch / completion, goal_times(mission), LIMITS['task time']
    mean = mean_seconds(times, epoch)
    for number, (goal, seconds) in enumerate(zip(mission.goals, times, strict=True)):
        if goal.task is None or seconds is None or limit.hold(max(seconds, epoch) / done):
            continue
        fits = limit.hold(mean / done)
        text = f'takes about {seconds:.0f} s, faults.done_in (completion) says {done:.0f} s'
        instead = (
            'that is about the mean of all goals'
            if fits
            else f'give {mean:.0f} s, the mean of all goals'
        )
        yield Finding(f'goals.{number}.task', goal.name, f'{text}: {instead}', note=fits)
