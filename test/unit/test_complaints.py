"""What comes into the log of complaints, in simulated time."""

from __future__ import annotations

import pytest

from uav_mission_manager.nodes.complaints import QUIET_TIME, Complaints


class Log:
    def __init__(self) -> None:
        self.now, self.lines = 0.0, []
        self.complaints = Complaints(self.lines.append, lambda: self.now)


@pytest.fixture
def log() -> Log:
    return Log()


def test_what_goes_on_is_said_once(log: Log) -> None:
    for log.now in range(100):
        log.complaints.add('odom', 'odom: far off')
        log.complaints.flush()
    assert log.lines == ['odom: far off']
    assert log.complaints.current == {'odom': 'odom: far off'}


def test_what_comes_back_is_said_again_but_not_too_soon(log: Log) -> None:
    for _ in range(3):
        log.complaints.add('odom', 'odom: far off')
        log.complaints.settle('odom')
    assert (log.lines, log.complaints.current) == (['odom: far off'], {})
    log.now = QUIET_TIME
    log.complaints.flush()
    log.complaints.flush()
    assert log.lines[1:] == ['odom: far off (1 more like this left out)']


def test_a_flood_of_ever_new_complaints_is_a_line_every_few_seconds(log: Log) -> None:
    seconds, rate = 20, 1000
    for count in range(seconds * rate):
        log.now = count / rate
        log.complaints.add('fault_mode', f'fault_mode: {count}')
    assert len(log.lines) == seconds / QUIET_TIME
    assert log.lines[1] == 'fault_mode: 5000 (4,999 more like this left out)'
    assert log.complaints.current == {'fault_mode': f'fault_mode: {count}'}


def test_the_last_of_a_burst_is_said_though_nothing_follows(log: Log) -> None:
    for text in 'one', 'two', 'three':
        log.complaints.add('kind', text)
    log.complaints.flush()
    assert log.lines == ['one']
    log.now = QUIET_TIME
    log.complaints.flush()
    assert log.lines == ['one', 'three (1 more like this left out)']


def test_kinds_do_not_hold_up_each_other(log: Log) -> None:
    log.complaints.add('odom', 'odom: bad')
    log.complaints.add('battery', 'battery: bad')
    assert log.lines == ['odom: bad', 'battery: bad']
