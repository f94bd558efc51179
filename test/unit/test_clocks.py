"""What a watch over a clock says, by the times it is shown."""

from __future__ import annotations

from itertools import accumulate

import pytest

from uav_mission_manager.nodes.clocks import (
    LONGEST_STEP,
    STANDING_TIME,
    TOLD_TIME,
    WATCH_PERIOD,
    ClockComparison,
    WorkingTime,
)

NOW = 1.7e9


def problems(steps: list[float], simulated: bool = False, start: float = NOW) -> list[str]:
    """Return what is said after each step [s] of the clock, one a period."""
    watch = ClockComparison()
    watch.look(start, 0.0, simulated)
    said = []
    for count, time in enumerate(accumulate(steps, initial=start)):
        watch.look(time, count * WATCH_PERIOD, simulated)
        said.append(watch.problem)
    return said[1:]


STEADY = [WATCH_PERIOD] * 10


@pytest.mark.parametrize('simulated', [False, True])
def test_a_clock_that_goes_is_all_right(simulated: bool) -> None:
    assert set(problems(STEADY, simulated)) == {''}


@pytest.mark.parametrize('pace', [0.1, 1.0, 50.0])
def test_simulated_time_goes_at_any_pace(pace: float) -> None:
    steps = [pace * WATCH_PERIOD] * 20
    assert set(problems(steps, simulated=True)) == {''}
    assert bool(problems(steps)[-1]) == (pace > 3.0)


@pytest.mark.parametrize('simulated', [False, True])
@pytest.mark.parametrize('step', [-1000.0, -2.0, 1000.0])
def test_a_jump_is_said_for_a_while(step: float, simulated: bool) -> None:
    after = [WATCH_PERIOD] * int(TOLD_TIME / WATCH_PERIOD + 2)
    said = problems([*STEADY, step + WATCH_PERIOD * (not simulated), *after], simulated)
    assert set(said[:10]) == {''}
    assert set(said[10:-3]) == {f'the clock jumped by {step:+.1f} s'}
    assert said[-1] == ''


@pytest.mark.parametrize('start', [0.0, NOW])
def test_a_clock_that_stands_is_said_until_it_goes(start: float) -> None:
    standing = [0.0] * int(STANDING_TIME / WATCH_PERIOD + 3)
    said = problems([*standing, 0.01, 0.01], simulated=True, start=start)
    assert said[0] == ''
    assert set(said[3:-2]) == {'the clock stands'}
    assert said[-2:] == ['', '']


def test_the_first_time_of_a_simulation_is_no_jump() -> None:
    assert set(problems([0.0, NOW, WATCH_PERIOD], simulated=True, start=0.0)) == {''}


def test_time_in_which_a_node_stood_still_does_not_count():
    times = iter([100.0, 101.0, 103.5, 163.5, 164.5])
    working = WorkingTime(lambda: next(times))
    assert [working() for _ in range(4)] == [
        101.0,
        103.5,
        103.5 + LONGEST_STEP,
        104.5 + LONGEST_STEP,
    ]
