"""What RViz, Foxglove and the aggregator of diagnostics are given names what the nodes have."""

from __future__ import annotations

import json
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from builtin_interfaces.msg import Time

from uav_mission_manager import load_mission, load_policy
from uav_mission_manager.autopilot.bridge import BridgeStep
from uav_mission_manager.autopilot.task import Phase, PilotOutput
from uav_mission_manager.autopilot.telemetry import Position
from uav_mission_manager.frames import body_frame
from uav_mission_manager.nodes import qos, vehicle_outputs
from uav_mission_manager.nodes.reporting import manager_health
from uav_mission_manager.nodes.topics import TOPICS
from uav_mission_manager.onboard import Refusal, Situation
from uav_mission_manager.paths import share_directory

CONFIG = share_directory() / 'config'
RVIZ = yaml.safe_load((CONFIG / 'mission.rviz').read_text())['Visualization Manager']
FOXGLOVE = json.loads((CONFIG / 'foxglove.json').read_text())
AGGREGATOR = yaml.safe_load((CONFIG / 'diagnostics.yaml').read_text())
POLICY = load_policy(share_directory() / 'policies' / 'case_study')
PROFILES = {'/manager/markers': qos.LATCHED, '/odom': qos.SENSOR}


def test_rviz_shows_what_is_published_as_it_is_published():
    assert RVIZ['Global Options']['Fixed Frame'] == 'map'
    topics = {d['Topic']['Value']: d['Topic'] for d in RVIZ['Displays'] if 'Topic' in d}
    assert topics.keys() == PROFILES.keys()
    for topic, settings in topics.items():
        assert topic.lstrip('/') in TOPICS
        words = settings['Durability Policy'], settings['Reliability Policy']
        profile = PROFILES[topic]
        names = (
            each.name.replace('_', ' ').title()
            for each in (profile.durability, profile.reliability)
        )
        assert words == tuple(names)
    kinds = {d['Class'].rpartition('/')[2] for d in RVIZ['Displays']}
    assert kinds == {'MarkerArray', 'Odometry', 'TF'}


def panels(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        yield from (*panels(layout['first']), *panels(layout['second']))


def topics_in(tree: Any) -> Iterator[str]:
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        for text in (key, value):
            if isinstance(text, str) and text.startswith('/'):
                yield text.partition('.')[0].partition(':')[0]
        if isinstance(value, (dict, list)):
            yield from topics_in(value)


def test_foxglove_shows_what_is_published():
    shown = FOXGLOVE['configById']
    assert sorted(panels(FOXGLOVE['layout'])) == sorted(shown)
    assert shown['3D!mission']['followTf'] == 'map'
    topics = {topic for topic in topics_in(shown) if topic != '/uav1/manager'}
    assert {topic.removeprefix('/uav1/') for topic in topics} == {
        *('manager/markers', 'odom', 'manager/decision', 'battery_state'),
        '/diagnostics',
    }
    assert {topic.removeprefix('/uav1/') for topic in topics} <= TOPICS.keys()
    assert shown['DiagnosticStatusPanel!why']['selectedName'] == '/uav1/manager: decision'


def analyzers(group: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for each in group.values():
        assert each['path']
        if each['type'] == 'diagnostic_aggregator/AnalyzerGroup':
            yield from analyzers(each['analyzers'])
        else:
            assert each['type'] == 'diagnostic_aggregator/GenericAnalyzer'
            yield each


@pytest.mark.parametrize('namespace', ['', '/uav1', '/fleet/uav1'])
def test_each_status_has_one_place_in_the_aggregator(namespace):
    situation, troubles = Situation(POLICY.mission), {'clock': '', 'memory': ''}
    name = f'{namespace}/manager'
    said = manager_health(name, ('p', POLICY), Refusal(''), situation, {}, troubles, 0.0, 3.0)
    names = [status.name for status in said] + [f'{namespace}/mavlink_bridge: autopilot']
    names += ['/fleet: goals', '/fleet: memory', f'/fleet: {namespace}/uav1']
    parameters = dict(AGGREGATOR['analyzers']['ros__parameters'])
    assert parameters.pop('path')
    found = list(analyzers(parameters))
    for status in names:
        assert sum(any(word in status for word in each['contains']) for each in found) == 1
    for each in found:
        assert any(word in status for word in each['contains'] for status in names)


@pytest.mark.parametrize(
    ('namespace', 'frame'),
    [('/', 'base_link'), ('/uav1', 'uav1/base_link'), ('/fleet/uav1', 'fleet/uav1/base_link')],
)
def test_the_frame_of_a_vehicle_is_called_after_its_namespace(namespace, frame):
    assert body_frame(namespace) == frame


class Transforms(SimpleNamespace):
    """In the place of tf2_msgs' message, which is not on PyPI."""


@pytest.mark.parametrize('there', [True, False])
def test_the_transform_is_what_the_odometry_says(monkeypatch, there):
    sent: dict[str, Any] = {}

    def publisher(kind, topic, profile, **_):
        sent.setdefault(topic, None)
        return SimpleNamespace(publish=lambda message: sent.__setitem__(topic, message))

    node = SimpleNamespace(
        create_publisher=publisher,
        get_namespace=lambda: '/uav1',
        get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: Time(sec=5))),
    )
    monkeypatch.setattr(vehicle_outputs, 'TFMessage', Transforms if there else None)
    mission = load_mission(CONFIG / 'case_study.yaml')
    origin = mission.grid.origin
    outputs = vehicle_outputs.VehicleOutputs(node, origin, lambda: [], lambda *_: None)
    place = origin.to_geodetic(30.0, -40.0)
    position = Position(0.0, *place, origin.altitude + 20.0, 20.0, heading=0.0)
    step = BridgeStep(PilotOutput(Phase.EN_ROUTE, ''), {}, position, None, ())
    outputs.publish(step, 3, 0.0)
    odom = sent['odom']
    assert (odom.header.frame_id, odom.child_frame_id) == ('map', 'uav1/base_link')
    assert sent['global_position'].header.frame_id == 'uav1/base_link'
    assert ('/tf' in sent) == there
    if there:
        [transform] = sent['/tf'].transforms
        assert (transform.header, transform.child_frame_id) == (odom.header, 'uav1/base_link')
        shift, turn = transform.transform.translation, transform.transform.rotation
        assert (shift.x, shift.y, shift.z) == pytest.approx((30.0, -40.0, 20.0), abs=1e-3)
        # It heads north: a quarter turn to the left of east.
        assert (turn.z, turn.w) == pytest.approx((0.5**0.5, 0.5**0.5))
