"""The energy model against numbers worked by hand, and its properties."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_mission_manager.mdp import Energy, load_mission
from uav_mission_manager.mdp.range_model import endurance, flight_range, required_ranges
from uav_mission_manager.onboard import range_flags

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')
ENERGY = Energy(
    capacity=4.0,
    voltage=15.0,
    power=240.0,
    speed=5.0,
    wind=8.0,
    wind_penalty=100.0,
    payload=0.5,
    payload_penalty=400.0,
)
CHARGE = st.floats(0.0, 1.0)
DISTANCES = st.lists(st.floats(0.0, 6000.0), min_size=1, max_size=5)


def test_endurance_is_in_seconds() -> None:
    # 4 Ah at 15 V are 60 Wh; 240 W draw them in a quarter of an hour.
    assert endurance(ENERGY, 1.0) == pytest.approx(900.0)
    assert endurance(ENERGY, 0.5) == pytest.approx(450.0)


def test_range_less_wind_and_payload() -> None:
    assert flight_range(ENERGY, 1.0) == pytest.approx(5.0 * 900.0 - 800.0 - 200.0)
    assert flight_range(ENERGY, 0.0) == pytest.approx(-1000.0)


def test_required_range_goes_over_the_goal_to_the_service_cell() -> None:
    # From the base: goal 1 in cell 5 (50, -50), service in cell 1 (50, 0), cells of 50 m.
    first, second, third = required_ranges(MISSION, (0.0, 0.0))
    assert first == pytest.approx(50.0 * math.sqrt(2.0) + 50.0)
    assert second == pytest.approx(150.0 + 100.0)
    assert third == pytest.approx(50.0 * math.sqrt(5.0) + 50.0 * math.sqrt(2.0))


@pytest.mark.parametrize(
    ('previous', 'distance', 'flag'),
    [
        (1, 2000.0, 1),
        (1, 2000.1, 0),  # sigma is 2000 m at a charge of 2/3
        (0, 2000.0, 0),
        (0, 1591.0, 1),  # 1.2 times that, and the 90 m of two points
        (0, 1592.0, 0),
    ],
)
def test_flag_at_the_limit(previous: int, distance: float, flag: int) -> None:
    assert range_flags(ENERGY, 2.0 / 3.0 + 1e-12, [distance], [previous], 0.2) == (flag,)


def test_full_charge_brings_back_what_it_can_reach() -> None:
    reach = flight_range(ENERGY, 0.95)
    assert range_flags(ENERGY, 0.95, [reach], [0], 0.2) == (1,)
    assert range_flags(ENERGY, 1.0, [reach + 100.0], [0], 0.2) == (1,)
    assert range_flags(ENERGY, 1.0, [flight_range(ENERGY, 1.0) + 1.0], [0], 0.2) == (0,)


@pytest.mark.parametrize('share', [1.0, 0.7])
def test_a_charger_that_stops_at_90_percent_brings_back_what_it_can_reach(share: float) -> None:
    """As a message has 90 %, a little less."""
    charge = 0.8999999761581421 * share
    for percent in (60, 80, 89):
        needed = [flight_range(ENERGY, percent / 100.0 * share)]
        assert range_flags(ENERGY, charge, needed, [0], 0.2, share) == (1,)


@given(charge=CHARGE, distances=DISTANCES)
def test_without_margin_the_flag_is_the_papers_rule(charge: float, distances: list[float]) -> None:
    rule = tuple(int(flight_range(ENERGY, charge) >= d) for d in distances)
    assert range_flags(ENERGY, charge, distances, [1] * len(distances), 0.0) == rule


def test_an_old_battery_brings_back_what_it_can_reach_when_it_is_full() -> None:
    reach = flight_range(ENERGY, 0.95 * 0.8)
    assert range_flags(ENERGY, 0.8, [reach], [0], 0.2, share=0.8) == (1,)
    assert range_flags(ENERGY, 0.8, [reach], [0], 0.2) == (0,)


@pytest.mark.parametrize('hysteresis', [0.0, 0.2])
def test_a_lost_flag_needs_two_points_of_the_gauge_to_come_back(hysteresis: float) -> None:
    needed = [flight_range(ENERGY, 0.5)]
    for charge, flag in ((0.499, 0), (0.51, 0), (0.519, 0)):
        assert range_flags(ENERGY, charge, needed, [0], hysteresis) == (flag,)
    assert range_flags(ENERGY, 0.521 + 0.5 * hysteresis, needed, [0], hysteresis) == (1,)


@pytest.mark.parametrize('percent', range(90, 101))
def test_a_full_battery_brings_back_whatever_it_can_reach(percent: int) -> None:
    needed = [flight_range(ENERGY, percent / 100.0)]
    assert range_flags(ENERGY, 1.0, needed, [0], 0.2) == (1,)


@given(charge=CHARGE, more=CHARGE, distances=DISTANCES, margin=st.floats(0.0, 1.0))
def test_flags_grow_with_charge_and_a_lost_one_is_never_easier(
    charge: float,
    more: float,
    distances: list[float],
    margin: float,
) -> None:
    low, high = sorted((charge, more))
    for held in (0, 1):
        previous = [held] * len(distances)
        worse = range_flags(ENERGY, low, distances, previous, margin)
        better = range_flags(ENERGY, high, distances, previous, margin)
        assert all(a <= b for a, b in zip(worse, better))
    lost = range_flags(ENERGY, low, distances, [0] * len(distances), margin)
    kept = range_flags(ENERGY, low, distances, [1] * len(distances), margin)
    assert all(a <= b for a, b in zip(lost, kept))


@given(charge=CHARGE, wind=st.floats(0.0, 20.0))
def test_wind_costs_range(charge: float, wind: float) -> None:
    assert flight_range(replace(ENERGY, wind=wind), charge) <= flight_range(
        replace(ENERGY, wind=0.0), charge
    )
