"""The missions that the demo flies: two shipped ones, or the user's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
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

CASES = (
    ('Case I: one goal', 'case_one', case_one),
    ('Three goals', 'case_study', three_goals),
)
"""Title, mission file and script of the shipped flights."""


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


def shipped_missions(logs: Path) -> list[DemoMission]:
    """Return the shipped missions; their policy sets are built beside their logs."""
    config = share_directory() / 'config'
    found = []
    for title, name, script in CASES:
        mission, policy = load_mission(config / f'{name}.yaml'), logs / name / 'policy'
        build_policy(mission).save(policy)
        found.append(DemoMission(title, name, script, mission, policy))
    return found


def mission_of(policy: Path, speedup: float) -> DemoMission:
    """Return the mission that a policy set was built from, if it can be flown."""
    mission = load_policy(policy).mission
    for field, value in (('grid.origin', mission.grid.origin), ('energy', mission.energy)):
        if value is None:
            raise ValueError(f'{shown(policy)}: {field}: is missing in its mission; needed to fly')
    limit = max(MAX_GOAL_TIME / speedup, MAX_STEP_TIME)
    title = f'Mission {shown(mission.name)}'
    return DemoMission(title, 'mission', own_mission, mission, policy, limit)
