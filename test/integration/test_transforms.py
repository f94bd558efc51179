"""Transforms of a bridge in a process of its own, where tf2_msgs is installed."""

from __future__ import annotations

import pytest
from bridge_crew import Chain, crews
from ros_helpers import Ros

from uav_mission_manager.nodes import qos

tf2_msgs = pytest.importorskip('tf2_msgs.msg')


@pytest.fixture
def chain(ros: Ros):
    yield from crews(Chain, ros)


def test_every_position_has_its_transform(chain, ros: Ros) -> None:
    flight = chain()
    messages = ros.listen('/tf', tf2_msgs.TFMessage, qos.TRANSFORMS)
    flight.command = 'commit goal1 normal'
    flight.until(lambda: flight.completed, 'goal completed')
    sent = {
        (t.header.stamp.sec, t.header.stamp.nanosec): t for m in messages for t in m.transforms
    }
    moments = {(m.header.stamp.sec, m.header.stamp.nanosec): m for m in flight.odom}
    both = sent.keys() & moments.keys()
    assert len(both) > 10
    for moment in both:
        odom, transform = moments[moment], sent[moment]
        assert (transform.header.frame_id, transform.child_frame_id) == ('map', 'base_link')
        assert odom.child_frame_id == 'base_link'
        place, shift = odom.pose.pose.position, transform.transform.translation
        assert (shift.x, shift.y, shift.z) == (place.x, place.y, place.z)
        assert transform.transform.rotation == odom.pose.pose.orientation
