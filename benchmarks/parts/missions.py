"""The case study with fewer or more goals than its three."""

from __future__ import annotations

import dataclasses

from uav_mission_manager import load_mission
from uav_mission_manager.mdp import Mission
from uav_mission_manager.paths import share_directory

MORE_GOALS = ((7, 5.0, 2.5), (2, 4.0, 2.0), (4, 7.0, 3.0), (5, 3.0, 2.0), (3, 2.0, 1.0))
"""Cell, eta and delta of the goals from the fourth on."""


def case_study(k: int) -> Mission:
    """Case study with its first k goals, from the fourth on with goals of our own."""
    mission = load_mission(share_directory() / 'config' / 'case_study.yaml')
    goals = list(mission.goals)
    for number, (cell, eta, delta) in enumerate(MORE_GOALS, 4):
        name = f'goal{number}'
        goals.append(dataclasses.replace(goals[0], name=name, cell=cell, eta=eta, delta=delta))
    return dataclasses.replace(mission, goals=tuple(goals[:k]))
