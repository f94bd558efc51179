"""What charge counts, of all that is said of batteries."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_mission_manager import load_mission
from uav_mission_manager.autopilot import sim_autopilot
from uav_mission_manager.autopilot.simulator.battery import Pack, SimulatedBattery
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.physics import Conditions, Demand, SimulatedOrigin
from uav_mission_manager.onboard import InputError, Situation
from uav_mission_manager.onboard.battery import Batteries, BatteryReport

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')
ENERGY = MISSION.energy
THREE_CELLS = replace(ENERGY, voltage=11.1)


def charge(*reports, energy=ENERGY):
    """The charge that counts after reports of one battery, a second apart."""
    batteries = Batteries()
    for now, report in enumerate(reports):
        batteries = batteries.report('', report, energy, float(now))
    return batteries.worst(energy).charge(energy)


@pytest.mark.parametrize(
    ('voltage', 'counted'),
    [
        (12.6, 1.0),
        (11.1, 1.0),
        (10.545, 0.5),
        (9.99, 0.0),
        (9.9, 0.0),
        (9.0, 0.0),
        # Unknown: neither empty nor full.
        (math.nan, 1.0),
        (0.0, 1.0),
        (-3.0, 1.0),
        (12600.0, 1.0),
        (1.0, 1.0),
        (math.inf, 1.0),
    ],
)
@pytest.mark.parametrize('energy', [ENERGY, THREE_CELLS])
def test_a_full_gauge_is_not_believed_against_the_voltage_of_three_cells(energy, voltage, counted):
    """The case study's battery has four cells; those of simulated autopilots have three."""
    assert charge(BatteryReport(1.0, voltage), energy=energy) == pytest.approx(counted)


@pytest.mark.parametrize(
    ('voltage', 'counted'), [(16.8, 1.0), (14.8, 1.0), (14.06, 0.5), (13.32, 0.0), (12.8, 0.0)]
)
def test_nor_against_that_of_four(voltage, counted):
    assert charge(BatteryReport(1.0, voltage)) == pytest.approx(counted)


def test_a_battery_of_four_cells_stays_one_when_it_is_empty():
    full, empty = BatteryReport(1.0, 16.0), BatteryReport(0.9, 12.0)
    assert charge(full, empty) == 0.0
    assert charge(empty) == 0.9
    heard = Batteries().report('', full, ENERGY, 0.0)
    again = Batteries.remembered(heard.memory).report('', empty, ENERGY, 1.0)
    assert again.worst(ENERGY).charge(ENERGY) == 0.0


@pytest.mark.parametrize('energy', [ENERGY, THREE_CELLS])
def test_a_simulated_battery_is_believed_until_it_is_nearly_empty(energy):
    battery = SimulatedBattery(cells=3)
    while battery.charge > 0.1:
        battery.drain(300.0, 1.0, 5.0, 0.0)
        reported = round(battery.charge, 2)
        report = BatteryReport(reported, battery.voltage, -battery.current)
        assert charge(report, energy=energy) == pytest.approx(reported)


@given(
    percentage=st.floats(0.0, 1.0),
    voltage=st.floats(allow_nan=True, allow_infinity=True),
    current=st.floats(allow_nan=True, allow_infinity=True),
    capacity=st.floats(allow_nan=True, allow_infinity=True),
    healthy=st.booleans(),
)
def test_no_number_makes_more_of_a_battery_than_its_percentage(
    percentage, voltage, current, capacity, healthy
):
    report = BatteryReport(percentage, voltage, current, capacity, healthy)
    assert 0.0 <= charge(report, report) <= percentage
    situation = Situation(MISSION).with_battery(
        percentage, 0.0, healthy, voltage=voltage, current=current, capacity=capacity
    )
    assert all('\n' not in warning for warning in situation.warnings)


def test_a_battery_that_holds_less_than_it_did_counts_in_part():
    assert charge(BatteryReport(1.0, capacity=4.0)) == pytest.approx(0.8)
    for capacity in (5.5, 0.0, -1.0, 5000.0, math.nan):
        assert charge(BatteryReport(1.0, capacity=capacity)) == 1.0


def test_what_a_gauge_that_stands_still_hides_is_counted_by_the_current():
    still = BatteryReport(0.8, current=-18.0)  # 0.1 % of 5 Ah a second
    assert charge(*[still] * 49) == 0.8
    assert charge(*[still] * 101) == pytest.approx(0.7)
    assert charge(*[still] * 101, BatteryReport(0.79, current=-18.0)) == 0.79
    assert charge(*[BatteryReport(0.8, current=18.0)] * 101) == 0.8


def test_what_it_hid_is_not_forgotten_by_a_restart():
    batteries = Batteries()
    for now in range(101):
        batteries = batteries.report('', BatteryReport(0.8, current=-18.0), ENERGY, float(now))
    again = Batteries.remembered(batteries.memory).report('', BatteryReport(0.8), ENERGY, 200.0)
    assert again.worst(ENERGY).charge(ENERGY) == pytest.approx(0.7, abs=0.011)
    moved = Batteries.remembered(batteries.memory).report('', BatteryReport(0.79), ENERGY, 200.0)
    assert moved.worst(ENERGY).charge(ENERGY) == 0.79


def test_the_memory_does_not_change_with_every_report():
    batteries, memories = Batteries(), set()
    for n in range(300):
        report = BatteryReport(0.9 - n * 1e-4, 16.0, -18.0)
        batteries = batteries.report('', report, ENERGY, n / 10.0)
        memories.add(str(batteries.memory))
    assert len(memories) == 1


# Several


def test_of_several_batteries_the_least_counts_and_one_that_falls_silent_does_so_for_a_while():
    situation = Situation(MISSION, known=frozenset({'threat_level'}))
    situation = situation.with_position(0.0, 0.0, 0.0).with_battery(0.04, 0.0, battery='1')
    for now in range(5, 60, 5):
        situation = situation.with_battery(0.9, float(now), battery='0')
        assert situation.in_range == (0, 0, 0)
        said = 'battery_state: battery 1: silent, its last charge counts for 60 s'
        assert situation.warnings == ((said,) if now > 10 else ())
    situation = situation.with_battery(0.9, 61.0, battery='0')
    assert (situation.in_range, situation.warnings) == ((1, 1, 1), ())


def test_one_unhealthy_battery_of_several_is_enough():
    situation = Situation(MISSION).with_position(0.0, 0.0, 0.0)
    situation = situation.with_battery(0.9, 0.0, battery='a')
    situation = situation.with_battery(0.9, 0.0, healthy=False, battery='b')
    assert situation.in_range == (0, 0, 0)
    assert 'battery_state: battery b: reported unhealthy, counted as empty' in situation.warnings


def test_a_sender_with_ever_new_ids_is_refused():
    situation = Situation(MISSION)
    for n in range(16):
        situation = situation.with_battery(0.9, 0.0, battery=f'{n}')
    with pytest.raises(InputError, match="battery_state: 'x' is one battery too many"):
        situation.with_battery(0.9, 0.0, battery='x')
    assert len(situation.with_battery(0.9, 100.0, battery='0').batteries.by_id) == 1


# What is said


@pytest.mark.parametrize(
    ('report', 'said'),
    [
        (
            {'percentage': 1.0, 'voltage': 9.9},
            'battery_state: below 11.1 V, too low for its percentage: counted by its voltage',
        ),
        (
            {'percentage': 1.0, 'capacity': 4.0},
            "battery_state: a capacity of 4 Ah, less than the mission's 5 Ah: counted in part",
        ),
        ({'percentage': 0.05, 'voltage': 10.1}, None),
        ({'percentage': 0.9, 'voltage': 12.6, 'capacity': 5.0}, None),
    ],
)
def test_disagreement_is_said(report, said):
    situation = Situation(MISSION, known=frozenset({'threat_level'}))
    situation = situation.with_battery(now=0.0, **report)
    assert situation.warnings == ((said,) if said else ())


def test_a_standstill_is_said():
    situation = Situation(MISSION)
    for now in range(60):
        situation = situation.with_battery(0.8, float(now), current=-18.0)
    assert situation.warnings[0] == (
        'battery_state: its percentage stands still while current flows: counted by the current'
    )


def test_the_noise_of_a_voltage_flips_no_flag():
    situation = Situation(MISSION, settling_time=5.0).with_position(0.0, 0.0, 0.0)
    flags = []
    for n in range(600):
        voltage = 10.25 + 0.1 * math.sin(n * n)
        situation = situation.with_battery(0.9, n / 10.0, voltage=voltage)
        flags.append(situation.in_range)
    assert len(set(flags)) > 1
    assert sum(before != after for before, after in pairwise(flags)) <= MISSION.k


def test_a_simulated_vehicle_has_the_battery_asked_for():
    flight = SimulatedFlight(
        SimulatedOrigin(0.0, 0.0, 0.0), pack=Pack(cells=6, capacity=18.0, hover_power=1100.0)
    )
    assert flight.body.battery.voltage == pytest.approx(6 * 4.2)
    assert flight.parameters['SIM_BATT_CAP_AH'] == 18.0
    assert flight.parameters['BATT_LOW_VOLT'] == 6 * 3.5
    for _ in range(60):
        flight.body.step(1.0, Demand(0j, 0.0), Conditions(capacity=18.0), True)
    hours = 60.0 / 3600.0
    assert 1.0 - flight.body.battery.charge == pytest.approx(
        1100.0 * hours / (6 * 4.2 * 18.0), rel=0.03
    )


@pytest.mark.parametrize('text', ['6,18', '6,x,1100', '6.5,18,1100', '0,18,1100', '6,18,inf'])
def test_no_battery_is_refused_in_words(text, capsys):
    with pytest.raises(SystemExit):
        sim_autopilot.main(['--battery', text])
    assert 'is not' in capsys.readouterr().err.splitlines()[-1]
