"""The section `fleet` of a mission file."""

from __future__ import annotations

import pytest
from strategies import case_study

from uav_mission_manager.mdp import MissionError, mission_from_dict
from uav_mission_manager.mdp.fleet_rules import FleetRules, PriorityWeights
from uav_mission_manager.solver.recombination import FleetPlanner

ALL = {
    'preconditions': {'goal3': ['goal1', 'goal2']},
    'agents': {'goal1': 2},
    'thresholds': {'goal2': 0.5},
    'threshold': 0.01,
    'persistence': 0.2,
    'weights': {'urgency': 2.0},
}


def mission(**fleet):
    return mission_from_dict({**case_study(), 'fleet': fleet}, 'x.yaml')


def test_all_that_can_be_asked_for():
    found = mission(**ALL).fleet
    assert found.weights == PriorityWeights(reward=1.0, urgency=2.0)
    assert (found.agents, found.thresholds) == (ALL['agents'], ALL['thresholds'])
    assert (found.threshold, found.persistence) == (0.01, 0.2)
    assert dict(found.preconditions) == {'goal3': ('goal1', 'goal2')}
    limits = found.limits(['goal1', 'goal2', 'goal3'])
    assert limits.before.tolist() == [[False] * 3, [False] * 3, [True, True, False]]
    assert limits.counts.tolist() == [2, 1, 1]
    assert limits.thresholds.tolist() == [0.01, 0.5, 0.01]


def test_without_the_section_there_are_the_defaults():
    assert mission_from_dict(case_study(), 'x.yaml').fleet == mission().fleet == FleetRules()


def test_it_is_no_part_of_the_decision_process():
    plain, other = mission_from_dict(case_study(), 'x.yaml'), mission(**ALL)
    assert plain == other
    assert plain.digest() == other.digest()
    assert 'fleet' not in plain.to_dict()


def test_a_written_mission_is_read_as_it_was():
    assert mission_from_dict(mission(**ALL).to_dict(), 'y.yaml').fleet == mission(**ALL).fleet


def test_a_planner_keeps_to_it():
    assert FleetPlanner(mission(**ALL)).limits.counts.tolist() == [2, 1, 1]


@pytest.mark.parametrize(
    ('fleet', 'message'),
    [
        ({'agents': {'x': 1}}, "fleet: agents: 'x' is no goal of goal1, goal2, goal3"),
        ({'agents': {'goal1': 0}}, r'fleet.agents: goal1: 0 is outside 1\.\.'),
        ({'agents': 3}, r'fleet.agents: 3 is not a mapping'),
        ({'thresholds': {'goal1': 0}}, 'fleet.thresholds: goal1: 0 is not above 0'),
        ({'preconditions': {'goal1': 'goal2'}}, "goal1: 'goal2' is not a list of names"),
        ({'preconditions': {'goal1': ['goal1']}}, 'a cycle: goal1 before goal1'),
        ({'preconditions': {'goal1': [2]}}, 'goal1: 2 is not a name'),
        ({'weights': {'reward': 0}}, 'fleet: all priority weights are 0'),
        ({'weights': {'rewrd': 1}}, "fleet.weights.rewrd: is unknown; .* 'reward'"),
        ({'threshold': -1}, 'fleet.threshold: -1 is not above 0'),
        ({'agent': {}}, "fleet.agent: is unknown; the nearest known key is 'agents'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(fleet, message):
    with pytest.raises(MissionError, match=rf'^x\.yaml: .*{message}') as refusal:
        mission(**fleet)
    assert '\n' not in str(refusal.value)
