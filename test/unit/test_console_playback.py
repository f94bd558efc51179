"""A recorded flight on the page: what was known at each moment, and where the page is."""

from __future__ import annotations

import math
import random
from types import SimpleNamespace as Message

import pytest

from uav_mission_manager.console import playback as playback_module
from uav_mission_manager.console.heard import Heard
from uav_mission_manager.console.messages import DIAGNOSTICS_TOPIC, Moment, heard_after
from uav_mission_manager.console.playback import (
    FLIGHT_STEP,
    Playback,
    RecordedFlight,
    heard_flight,
)

FAULTS = ('nominal', 'sensor', 'actuator')


def faults(count, seed=0):
    """Messages of one topic at random times, in their order."""
    rng = random.Random(seed)
    times = sorted(rng.uniform(0.0, 20.0) for _ in range(count))
    return [
        (Moment(at, f'{at:.3f}'), 'fault_mode', Message(data=rng.choice(FAULTS))) for at in times
    ]


def test_at_each_kept_moment_is_known_what_was_said_before_it():
    said = faults(300)
    flight = heard_flight('/uav1', said, 20.0)
    assert list(flight.times) == sorted(flight.times)
    for at, heard in zip(flight.times[:-1], flight.heard):
        expected = Heard()
        for moment, topic, message in said:
            if moment.at < at:
                expected = heard_after(expected, topic, message, moment)
        assert heard == expected
    for at, heard in zip(flight.times[:-2], flight.heard):  # The last two may be of one time.
        assert flight.at(at + 1e-6) is heard
    assert flight.at(math.inf).fault.value == said[-1][2].data
    assert flight.at(-1.0) == Heard()


def test_a_flight_however_long_has_not_too_many_moments(monkeypatch):
    monkeypatch.setattr(playback_module, 'MOST_MOMENTS', 10)
    flight = heard_flight('/uav1', faults(300), 20.0)
    assert len(flight.times) <= 12
    assert max(b - a for a, b in zip(flight.times, flight.times[1:])) < 4.0
    assert flight.at(20.0).fault.value == faults(300)[-1][2].data


def test_of_the_diagnostics_only_the_vehicles_own_bridge_counts():
    def status(vehicle, phase):
        values = [Message(key='phase', value=phase), Message(key='link', value='up')]
        name = f'{vehicle}/mavlink_bridge: autopilot'
        return Message(name=name, message=phase, values=values)

    both = Message(status=[status('/uav1', 'holding'), status('/uav2', 'landing')])
    flight = heard_flight('/uav1', [(Moment(1.0, ''), DIAGNOSTICS_TOPIC, both)], 1.0)
    assert flight.at(1.0).bridge.value.phase == 'holding'


def test_a_bag_in_which_nothing_is_heard_is_a_flight_of_one_moment():
    flight = heard_flight('/uav1', [], 0.0)
    playback = Playback(flight, lambda: 5.0)
    playback.toggle()
    assert (playback.position, playback.ended, playback.heard()) == (0.0, True, Heard())


class Hand:
    """A playback of ten seconds, and the clock of who looks."""

    def __init__(self):
        self.now = 100.0
        times = tuple(FLIGHT_STEP * n for n in range(51))
        self.playback = Playback(RecordedFlight('', times, (Heard(),) * 51), lambda: self.now)

    def after(self, seconds):
        self.now += seconds
        return self.playback.position


def test_it_plays_pauses_and_goes_on_from_there():
    hand = Hand()
    assert hand.after(3.0) == 0.0
    hand.playback.toggle()
    assert hand.after(3.0) == pytest.approx(3.0)
    hand.playback.toggle()
    assert hand.after(3.0) == pytest.approx(3.0)
    hand.playback.toggle()
    assert hand.after(1.0) == pytest.approx(4.0)


def test_another_speed_counts_from_now_on_only():
    hand = Hand()
    hand.playback.toggle()
    hand.after(2.0)
    hand.playback.set_speed(5.0)
    assert hand.playback.position == pytest.approx(2.0)
    assert hand.after(1.0) == pytest.approx(7.0)
    hand.playback.set_speed(0.5)
    assert hand.after(2.0) == pytest.approx(8.0)


@pytest.mark.parametrize(('to', 'there'), [(6.5, 6.5), (-3.0, 0.0), (99.0, 10.0)])
@pytest.mark.parametrize('playing', [False, True])
def test_it_goes_where_it_is_told_and_no_farther_than_the_flight(to, there, playing):
    hand = Hand()
    if playing:
        hand.playback.toggle()
        hand.after(1.0)
    hand.playback.seek(to)
    assert hand.playback.position == pytest.approx(there)
    assert hand.after(1.0) == pytest.approx(min(there + playing, 10.0))


def test_at_the_end_it_stays_and_plays_from_the_beginning_when_asked():
    hand = Hand()
    hand.playback.toggle()
    assert hand.after(11.0) == 10.0
    assert hand.playback.ended
    hand.playback.toggle()
    assert hand.playback.position == 0.0
    assert hand.after(2.0) == pytest.approx(2.0)
