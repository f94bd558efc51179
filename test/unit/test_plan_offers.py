"""The bridge's plan: another one takes its place with the manager's command, and not before."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String
from test_placing import GRID, MISSION, PLAIN, added, placed

from uav_mission_manager import build_policy
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import FlightTask, Settings
from uav_mission_manager.mdp import Mission
from uav_mission_manager.nodes import manager_inputs
from uav_mission_manager.nodes.flight_plan import FlightPlan, Plans
from uav_mission_manager.nodes.plan_offers import plan_after

OLD, NEW = FlightPlan(MISSION, 20.0), FlightPlan(placed(cell=7, name='tree'), 20.0, 'set')
NOW = {'source_timestamp': 0, 'received_timestamp': 0}


class Bridge:
    """The manager's inputs of a bridge, by their callbacks, and what the pilot was told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.said: list[str] = []
        self.heard: dict[str, Any] = {}
        self.tasks: list[FlightTask] = []
        log = SimpleNamespace(info=self.said.append, error=self.said.append)
        node: Any = SimpleNamespace(
            create_subscription=lambda _, topic, hear, *__, **___: self.heard.update(
                {topic: hear}
            ),
            get_logger=lambda: log,
            get_clock=lambda: None,
        )
        monkeypatch.setattr(manager_inputs, 'safety_clock', lambda: None)
        monkeypatch.setattr(manager_inputs, 'seconds', lambda clock: 0.0)
        pilot = Pilot(Settings(), OLD.ground)
        monkeypatch.setattr(pilot, 'command', lambda task, now: self.tasks.append(task))
        self.plans = Plans(OLD)
        self.inputs = manager_inputs.ManagerInputs(node, self.plans, pilot, 3.0)

    def command(self, text: str, cell: int) -> FlightTask | None:
        """Hear a command and its pose; return the task, None where it is not flown."""
        message = PoseStamped()
        message.header.frame_id = 'map'
        message.pose.position.x, message.pose.position.y = GRID.position(cell)
        self.tasks.clear()
        self.heard['command_pose'](message)
        self.heard['mission_command'](String(data=text), NOW)
        return self.tasks[0] if self.tasks else None


@pytest.fixture
def bridge(monkeypatch: pytest.MonkeyPatch) -> Bridge:
    return Bridge(monkeypatch)


def place_of(cell: int) -> tuple[float, float]:
    return GRID.origin.to_geodetic(*GRID.position(cell))


def flown_to(task: FlightTask | None) -> tuple[str, float, float]:
    assert task is not None
    return task.goal, task.latitude, task.longitude


def test_a_goal_that_was_requested_is_flown_to_from_the_managers_command_on(bridge):
    assert bridge.command('commit tree normal', 7) is None
    bridge.plans.next = NEW
    assert flown_to(bridge.command('commit goal1 normal', 5)) == ('goal1', *place_of(5))
    assert flown_to(bridge.command('commit goal2 normal', 3)) == ('goal2', *place_of(3))
    assert bridge.plans.present is OLD
    assert flown_to(bridge.command('commit tree agile', 7)) == ('tree', *place_of(7))
    assert bridge.plans == Plans(NEW)
    assert bridge.said[-1] == 'goals are now goal1, tree, goal3: set'
    assert bridge.command('commit goal2 normal', 3) is None
    assert flown_to(bridge.command('commit goal1 normal', 5)) == ('goal1', *place_of(5))


def test_a_goal_that_was_added_is_flown_to_from_the_managers_command_on(bridge):
    bridge.plans.next = FlightPlan(added(cell=7, name='tree'), 20.0, 'set')
    assert flown_to(bridge.command('commit goal2 normal', 3)) == ('goal2', *place_of(3))
    assert bridge.plans.present is OLD
    assert flown_to(bridge.command('commit tree normal', 7)) == ('tree', *place_of(7))
    assert bridge.said[-1] == 'goals are now goal1, goal2, goal3, tree: set'


def test_a_command_that_leads_elsewhere_than_its_pose_changes_no_plan(bridge):
    bridge.plans.next = NEW
    for _ in range(2):
        assert bridge.command('commit tree normal', 6) is None
        assert bridge.command('commit goal1 normal', 7) is None
        assert bridge.command('commit nest normal', 7) is None
    assert bridge.plans == Plans(OLD, NEW)


@pytest.mark.parametrize(
    ('mission', 'words'),
    [
        (replace(PLAIN, goals=placed(cell=7).goals), ''),
        (MISSION, None),
        (added(cell=7), ''),
        (replace(MISSION, goals=PLAIN.goals[:2]), 'the policy is for other goals'),
        (replace(MISSION, grid=replace(GRID, bearing=10.0)), 'the policy is for another grid'),
    ],
)
def test_a_policy_set_offers_a_plan_or_is_refused(mission: Mission, words, tmp_path):
    path = tmp_path / 'set'
    build_policy(mission).save(path)
    if words:
        with pytest.raises(ValueError, match=f'{path}: {words}'):
            plan_after(OLD, str(path))
    else:
        plan = plan_after(OLD, str(path))
        assert (plan is None) == (words is None)
        assert plan is None or (plan.source, plan.mission) == (str(path), mission)


def test_a_policy_set_that_was_altered_is_refused(tmp_path):
    path = tmp_path / 'set'
    build_policy(placed(cell=7)).save(path)
    manifest = json.loads((path / 'manifest.json').read_text())
    manifest['mission']['goals'][1]['cell'] = 4
    (path / 'manifest.json').write_text(json.dumps(manifest))
    with pytest.raises(ValueError, match='digest: does not match the manifest'):
        plan_after(OLD, str(path))
