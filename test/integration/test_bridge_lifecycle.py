"""The bridge's life cycle, with a vehicle on the ground and in the air."""

from __future__ import annotations

import pytest
from bridge_crew import ARM, GOAL2, Chain, Dummy, crews
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from ros_helpers import Ros


@pytest.fixture
def chain(ros: Ros):
    yield from crews(Chain, ros)


@pytest.fixture
def dummy(ros: Ros):
    yield from crews(Dummy, ros)


def change(ros: Ros, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return bool(ros.call('mavlink_bridge/change_state', request, ChangeState).success)


def state(ros: Ros) -> int:
    answer = ros.call('mavlink_bridge/get_state', GetState.Request(), GetState)
    return int(answer.current_state.id)


def test_it_waits_to_be_configured_and_activated_and_says_so(dummy, ros):
    flight = dummy(autostart=False)
    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    answer = ros.call('mavlink_bridge/hold')
    assert (answer.success, answer.message) == (False, 'not configured')
    assert state(ros) == State.PRIMARY_STATE_UNCONFIGURED
    assert change(ros, Transition.TRANSITION_CONFIGURE)
    ros.spin(4.0)
    assert (flight.heard(), flight.odom, flight.diagnostics) == (set(), [], [])
    answer = ros.call('mavlink_bridge/resume')
    assert (answer.success, answer.message) == (False, 'the bridge is not active')
    assert change(ros, Transition.TRANSITION_ACTIVATE)
    flight.until(lambda: ARM in flight.heard(), 'arming')


def test_in_flight_it_holds_while_it_is_not_active_and_goes_on(chain, ros):
    flight = chain(cruise_speed=2.0)
    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    flight.until_phase('en route')
    assert change(ros, Transition.TRANSITION_DEACTIVATE)
    begin = flight.distance(GOAL2)
    flight.odom.clear()
    assert not change(ros, Transition.TRANSITION_CLEANUP)
    assert flight.bridge.lines('the motors run')
    assert state(ros) == State.PRIMARY_STATE_INACTIVE
    ros.spin(3.0)
    assert flight.odom == []
    assert flight.bridge.lines('holding: the bridge is not active')
    assert change(ros, Transition.TRANSITION_ACTIVATE)
    flight.until(lambda: flight.odom, 'telemetry')
    assert begin - flight.distance(GOAL2) < 30.0
    flight.until(lambda: flight.completed, 'goal completed')


def test_cleaned_up_and_configured_anew_it_flies_with_the_same_port(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    assert ros.call('mavlink_bridge/hold').success
    for _ in range(2):
        assert change(ros, Transition.TRANSITION_DEACTIVATE)
        assert change(ros, Transition.TRANSITION_CLEANUP)
        assert not ros.call('mavlink_bridge/hold').success
        assert change(ros, Transition.TRANSITION_CONFIGURE)
        assert change(ros, Transition.TRANSITION_ACTIVATE)
    flight.diagnostics.clear()
    flight.until_phase('holding')
    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    assert ros.call('mavlink_bridge/resume').success
    flight.until(lambda: ARM in flight.heard(), 'arming')
