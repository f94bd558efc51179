"""Sensitivities of V* against enumeration, and against what scaling says."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from brute_force import BruteForce, solve
from strategies import PARTS, case_study, lively

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.evaluation.sensitivity import (
    by_occupancy,
    by_solving,
    parameters,
)

FLOWN = 200_000


def small():
    """One goal in three cells; every probability far from 0 and 1, and worth flying for."""
    document = lively()
    document['goals'] = document['goals'][:1]
    document['faults'] |= {'rate': dict.fromkeys(PARTS, 0.1), 'cost': [0.0, *[2.0] * 7]}
    document['range']['loss'] = {'normal': 0.1, 'agile': 0.2}
    document['threat']['onset'] = 0.1
    return document


def start_of(mission):
    k = mission.k
    return np.array([[1, *[1] * k, *[2] * k, mission.grid.base, 0, 0, 0]])


def enumerated(document):
    """V* at the start, all states written out."""
    model = BruteForce(document)
    start = (1, *[1] * model.k, *[2] * model.k, model.base, 0, 0, 0)
    return solve(model).v[model.states.index(start)]


def edited(document, *path, value):
    document = copy.deepcopy(document)
    node = document
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return document


def changes():
    """Field, and the document with it 10 % larger, each written out by hand."""
    d = small()
    yield 'goals.0.eta', edited(d, 'goals', 0, 'eta', value=11.0)
    yield 'goals.0.delta', edited(d, 'goals', 0, 'delta', value=5.5)
    yield 'faults.rate.actuator', edited(d, 'faults', 'rate', 'actuator', value=0.11)
    yield 'faults.completion.0', edited(d, 'faults', 'completion', 0, value=0.55)
    yield (
        'faults.agile_factor.actuator',
        edited(d, 'faults', 'agile_factor', 'actuator', value=2.75),
    )
    yield 'faults.repair_success', edited(d, 'faults', 'repair_success', value=0.66)
    yield 'threat.onset', edited(d, 'threat', 'onset', value=0.11)
    yield 'threat.cost.2.0', edited(d, 'threat', 'cost', 2, 0, value=13.2)
    yield 'threat.from_low.0', edited(d, 'threat', 'from_low', value=[0.55, 0.27, 0.18])
    yield 'range.loss.normal', edited(d, 'range', 'loss', 'normal', value=0.11)
    yield 'discount', edited(d, 'discount', value=1 - 0.05 / 1.1)
    yield (
        'priority_transition.0.1',
        edited(d, 'priority_transition', 0, value=[0.67 * 5 / 7, 0.33, 0.67 * 2 / 7]),
    )


@pytest.fixture(scope='module')
def policy():
    return build_policy(mission_from_dict(small(), 'test'), 'exact', tolerance=1e-10)


@pytest.fixture(scope='module')
def solved(policy):
    found = by_solving(policy.solution, start_of(policy.mission))
    return {sensitivity.name: sensitivity for sensitivity in found}


@pytest.mark.parametrize(('name', 'document'), list(changes()), ids=[n for n, _ in changes()])
def test_a_solution_of_the_changed_mission_is_that_of_enumeration(name, document, solved):
    before, after = enumerated(small()), enumerated(document)
    assert after != pytest.approx(before, rel=1e-7)
    assert solved[name].relative == pytest.approx(after / before - 1, abs=1e-6)


def test_the_derivative_agrees_with_the_solutions(policy, solved):
    """A backup in sampled states is right to first order: of 10 % that leaves out a tenth."""
    start = start_of(policy.mission)
    found = by_occupancy(policy.solution, policy.act, start, FLOWN)
    assert {s.name for s in found} == set(solved)
    for sensitivity in found:
        exact = solved[sensitivity.name].relative
        assert sensitivity.relative == pytest.approx(exact, rel=0.1, abs=6e-4)


def test_costs_together_scale_v(solved):
    """V* is homogeneous in the costs: their sensitivities sum to 10 %, to first order."""
    costs = ('eta', 'delta', 'cost', 'distance_weight', 'service_cost')
    total = sum(s.relative for s in solved.values() if set(costs) & set(s.name.split('.')))
    assert total == pytest.approx(0.1, rel=0.02)


def test_the_largest_come_first(policy):
    found = by_solving(policy.solution, start_of(policy.mission))
    sizes = [abs(sensitivity.relative) for sensitivity in found]
    assert sizes == sorted(sizes, reverse=True)


def test_every_changed_mission_is_a_mission_in_which_one_thing_differs():
    mission = mission_from_dict(case_study(), 'test')
    every = parameters(mission)
    assert len({parameter.name for parameter in every}) == len(every)
    for parameter in every:
        assert parameter.changed != parameter.value
        assert parameter.mission != mission
        assert parameter.mission.grid == mission.grid


def test_what_cannot_grow_shrinks():
    changed = {p.name: p.changed for p in parameters(mission_from_dict(case_study(), 'test'))}
    assert changed['faults.completion.0'] == 0.9
    assert changed['faults.repair_success'] == 0.9
    assert changed['faults.completion.1'] == pytest.approx(0.88)


def test_a_mission_without_costs_has_no_sensitivities():
    document = case_study(1, distance_weight=0.0, service_cost={})
    document['goals'][0] |= {'eta': 0.0, 'delta': 0.0}
    document['faults']['cost'] = [0.0] * 8
    document['range']['cost'] = 0.0
    document['threat']['cost'] = [[0.0, 0.0]] * 3
    mission = mission_from_dict(document, 'test')
    policy = build_policy(mission, 'exact')
    assert by_solving(policy.solution, start_of(mission)) == []
