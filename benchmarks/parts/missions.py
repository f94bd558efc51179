"""The case study with fewer or more goals than its three, and missions drawn at random."""

from __future__ import annotations

import dataclasses

import numpy as np

from uav_mission_manager import load_mission
from uav_mission_manager.mdp import Mission, mission_from_dict
from uav_mission_manager.mdp.charge import drain_by_energy
from uav_mission_manager.mdp.energy import Charge, Range
from uav_mission_manager.paths import share_directory

MORE_GOALS = (
    (7, 5.0, 2.5),
    (2, 4.0, 2.0),
    (4, 7.0, 3.0),
    (5, 3.0, 2.0),
    (3, 2.0, 1.0),
    (6, 9.0, 4.5),
    (7, 6.0, 3.0),
    (1, 3.0, 1.5),
    (4, 5.0, 2.5),
)
"""Cell, eta and delta of the goals from the fourth on."""


def case_study(k: int) -> Mission:
    """Case study with its first k goals, from the fourth on with goals of our own."""
    mission = load_mission(share_directory() / 'config' / 'case_study.yaml')
    goals = list(mission.goals)
    for number, (cell, eta, delta) in enumerate(MORE_GOALS, 4):
        name = f'goal{number}'
        goals.append(dataclasses.replace(goals[0], name=name, cell=cell, eta=eta, delta=delta))
    return dataclasses.replace(mission, goals=tuple(goals[:k]))


def with_battery(mission: Mission, levels: int = 16) -> Mission:
    """The mission with one battery in place of its range flags; to fly it empty costs 200."""
    assert mission.energy is not None
    drain = drain_by_energy(mission.energy, mission.grid.cell_size, levels, noise=0.2)
    charge = Charge(levels, reserve=0.1, drain=drain, empty_cost=200.0)
    return dataclasses.replace(mission, range=Range(mission.range.cost, charge=charge))


def random_mission(k: int, seed: int) -> Mission:
    """A mission of k goals with every number drawn from a wide range."""
    rng = np.random.default_rng(seed)
    rows, cols = int(rng.integers(1, 4)), int(rng.integers(3, 6))
    q = rows * cols

    def row(weights: np.ndarray) -> list[float]:
        return (weights / weights.sum()).tolist()

    def priorities() -> list[list[float]]:
        change = rng.uniform(0.01, 0.3, (3, 3))
        change[np.diag_indices(3)] = rng.uniform(1, 5, 3)
        return [row(weights) for weights in change]

    def failures(low: float, high: float) -> dict[str, float]:
        return {part: float(rng.uniform(low, high)) for part in ('sensor', 'actuator', 'camera')}

    completion = np.sort(rng.uniform(0, 1, 8))[::-1]
    completion[rng.integers(2, 8) :] = 0
    losses = np.sort(rng.uniform(0.01, 0.2, 2))
    threats = np.sort(rng.uniform(0, 15, (3, 2)), axis=0)
    return mission_from_dict(
        {
            'name': f'random_{seed}',
            'discount': float(rng.uniform(0.9, 0.98)),
            'grid': {
                'rows': rows,
                'cols': cols,
                'base': int(rng.integers(q)),
                'service': int(rng.integers(q)),
            },
            'goals': [
                {
                    'name': f'goal{j}',
                    'cell': int(rng.integers(q)),
                    'eta': float(rng.uniform(1, 15)),
                    'delta': float(rng.uniform(0, 8)),
                    'priority_transition': priorities(),
                }
                for j in range(1, k + 1)
            ],
            'faults': {
                'rate': failures(0.001, 0.05),
                'agile_factor': failures(1, 3),
                'repair_success': float(rng.uniform(0.5, 1)),
                'completion': completion.tolist(),
                'cost': [0.0, *np.sort(rng.uniform(0, 20, 7)).tolist()],
            },
            'range': {
                'loss': {'normal': float(losses[0]), 'agile': float(losses[1])},
                'cost': float(rng.uniform(0, 6)),
            },
            'threat': {
                'onset': float(rng.uniform(0.01, 0.2)),
                'zones': {
                    int(cell): float(rng.uniform(0, 0.4)) for cell in rng.integers(q, size=3)
                },
                'high_share': float(rng.uniform(0.1, 0.9)),
                'from_low': row(rng.uniform(0.1, 1, 3)),
                'from_high': row(rng.uniform(0.1, 1, 3)),
                'cost': threats.tolist(),
            },
            'distance_weight': float(rng.uniform(0.2, 3)),
            'service_cost': {
                'recharge': float(rng.uniform(0, 5)),
                'repair': float(rng.uniform(0, 8)),
            },
        },
        f'random_{seed}',
    )
