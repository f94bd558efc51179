"""The missions that the demo flies: two shipped ones, or the user's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from uav_mission_manager.cli.demo.flight import DemoFlight
from uav_mission_manager.cli.demo.scenarios import Wait, case_one, own_mission, three_goals
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission, load_mission
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import build_policy, load_policy

MAX_STEP_TIME = 60.0
"""Time [s] that each step of a scenario may take: a choice."""

MAX_GOAL_TIME = 3600.0
"""Simulated time [s] that each goal of a mission of one's own may take: a choice, beyond any task
that a battery lasts for."""

CASES = {
    'case_one': ('Case I: one goal', case_one),
    'case_study': ('Three goals', three_goals),
    'survey': ('Five goals on one battery', own_mission),
}
"""Title and script of the shipped flights, by mission file."""

USUAL_CASES = ('case_one', 'case_study')
"""What is flown unless something else is asked for: what is over in two minutes."""

SOLVED_BEFORE = ('survey',)
"""Missions that take too long to solve here: flown by the shipped policy set."""


@dataclass(frozen=True)
class DemoMission:
    """What the demo flies.

    Attributes
    ----------
    title, folder : str
        What it is called on the screen, and among the logs.
    script : callable
        What happens, see `scenarios`.
    mission : Mission
    policy : path
        The policy set built from it.
    limit : float
        Time [s] that each step of the script may take.
    """

    title: str
    folder: str
    script: Callable[[DemoFlight], Iterator[Wait]]
    mission: Mission
    policy: Path
    limit: float = MAX_STEP_TIME


def shipped_mission(name: str, logs: Path, speedup: float) -> DemoMission:
    """Return a shipped mission; its policy set is built beside its logs unless that takes long."""
    title, script = CASES[name]
    if name in SOLVED_BEFORE:
        own = mission_of(share_directory() / 'policies' / name, speedup)
        return replace(own, title=title, folder=name, script=script)
    mission = load_mission(share_directory() / 'config' / f'{name}.yaml')
    policy = logs / name / 'policy'
    build_policy(mission).save(policy)
    return DemoMission(title, name, script, mission, policy)


def mission_of(policy: Path, speedup: float) -> DemoMission:
    """Return the mission that a policy set was built from, if it can be flown."""
    mission = load_policy(policy).mission
    for field, value in (('grid.origin', mission.grid.origin), ('energy', mission.energy)):
        if value is None:
            raise ValueError(f'{shown(policy)}: {field}: is missing in its mission; needed to fly')
    limit = max(MAX_GOAL_TIME / speedup, MAX_STEP_TIME)
    title = f'Mission {shown(mission.name)}'
    return DemoMission(title, 'mission', own_mission, mission, policy, limit)
