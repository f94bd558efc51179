"""What the demo does in a mission of one's own, without any process."""

from __future__ import annotations

import json

import pytest
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.cli.demo import runner
from uav_mission_manager.cli.demo.scenarios import own_mission
from uav_mission_manager.mdp import mission_from_dict

MISSION = mission_from_dict(case_study(), 'test')
GRID = MISSION.grid


class Flight:
    """What a script sees of a flight, and what it did to it."""

    def __init__(self):
        self.mission = MISSION
        self.command, self.cell, self.on_ground = '', GRID.base, True
        self.asked, self.over, self.done = set(), set(), []

    home = property(lambda self: self.on_ground and self.cell == GRID.base)
    place = property(lambda self: self.on_ground and self.cell in (GRID.base, GRID.service))

    def ask(self, **priorities):
        self.asked |= set(priorities)

    def inject(self, what, **parameters):
        self.done.append(parameters)


def test_the_battery_is_replaced_whenever_the_vehicle_stands_there_for_it():
    flight = Flight()
    script = own_mission(flight)

    def met():
        """Whether what the script waits for is there; it goes on then."""
        if reached():
            waits.append(next(script, None))
            return True
        return False

    waits = [next(script)]

    def reached():
        return waits[-1][1]()

    assert not met()
    flight.command = 'none normal'
    assert met()
    assert flight.asked == {'goal1', 'goal2', 'goal3'}
    flight.over = {'goal2'}
    assert met()
    for flight.on_ground, flight.cell in ((False, GRID.service), (True, GRID.base)):
        flight.command = 'recharge'
        assert not met()
    for _ in range(2):
        flight.command, flight.on_ground, flight.cell = 'recharge', True, GRID.service
        assert met()
        assert not met()
        flight.command, flight.on_ground = 'commit goal1 normal', False
        assert met()
        assert not met()
    assert flight.done == [{'SIM_BATT_PCT': 100}] * 2
    flight.over = {'goal1', 'goal2', 'goal3'}
    assert met()
    assert not met()
    flight.on_ground = True
    assert met()
    assert waits[-1] is None, 'the end'


def test_what_is_no_policy_set_is_refused_in_one_line(tmp_path):
    with pytest.raises(
        SystemExit, match=r'^demo: .*manifest\.json: cannot be read: .*No such file'
    ):
        runner.main(['--policy', str(tmp_path), '--logs', str(tmp_path / 'logs')])


@pytest.mark.parametrize('field', ['energy', 'grid.origin'])
def test_a_mission_that_cannot_be_flown_is_refused(tmp_path, field):
    document = json.loads(json.dumps(case_study()))
    section, _, key = field.rpartition('.')
    (document[section] if section else document).pop(key)
    policy = tmp_path / 'set'
    build_policy(mission_from_dict(document, 'test'), method='exact').save(policy)
    with pytest.raises(SystemExit, match=rf'^demo: .*/set: {field}: is missing in its mission'):
        runner.main(['--policy', str(policy), '--logs', str(tmp_path / 'logs')])
    assert not (tmp_path / 'logs').exists()
