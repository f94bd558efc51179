"""The power that flight draws, against the mission's: told when it is sure, and never else."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest
from strategies import case_study

from uav_mission_manager.autopilot.bridge import BridgeStep
from uav_mission_manager.autopilot.task import Phase, PilotOutput
from uav_mission_manager.autopilot.telemetry import BatteryReading, Position, Telemetry
from uav_mission_manager.mdp import global_actions, mission_from_dict
from uav_mission_manager.nodes.flight_energy import FlightEnergy
from uav_mission_manager.onboard import parse_command
from uav_mission_manager.onboard.energy_use import EnergyUse

MISSION = mission_from_dict(case_study(), 'test')
NONE = global_actions(MISSION)[0]
ENERGY = replace(MISSION.energy, agile_power=400.0)
"""A full battery lasts for 1065.6 s at the 250 W of normal flight, for 666 s at agile flight's."""


class Vehicle:
    """Flies, and reports its charge in steps of the gauge, rounded in one way or another."""

    def __init__(self, energy=ENERGY, gauge=math.floor, start=1.0, period=1.0):
        self.use, self.energy, self.gauge, self.period = EnergyUse(energy), energy, gauge, period
        self.charge, self.now = start, 0.0

    def fly(self, seconds, power, agile=False):
        """Return what is told by then."""
        full = self.energy.capacity * self.energy.voltage * 3600.0
        for _ in range(round(seconds / self.period)):
            self.now += self.period
            self.charge -= power * self.period / full
            self.use.note(self.gauge(100.0 * self.charge) / 100.0, agile, self.now)
        return self.use.warnings


@pytest.mark.parametrize(
    ('power', 'agile', 'field', 'planned'),
    [
        (340.0, False, 'power', 250),
        (150.0, False, 'power', 250),
        (550.0, True, 'agile_power', 400),
        (280.0, True, 'agile_power', 400),
    ],
)
def test_another_power_is_told_with_the_figure_to_put_in(power, agile, field, planned):
    warnings = Vehicle().fly(450.0, power, agile)
    assert list(warnings) == [field]
    found = int(warnings[field].rpartition(' ')[2])
    assert found == pytest.approx(power, rel=0.11)
    where = 'in agile flight ' if agile else ''
    assert warnings[field] == (
        f'battery {where}drains at {found} W, mission says {planned} W: '
        f'set energy.{field} to {found}'
    )


def test_it_is_told_once_and_stays():
    vehicle = Vehicle()
    told = dict(vehicle.fly(400.0, 400.0))
    assert told
    assert vehicle.fly(200.0, 300.0) == told


def test_without_an_agile_power_agile_flight_is_planned_at_the_normal_one():
    vehicle = Vehicle(replace(ENERGY, agile_power=None))
    assert 'mission says 250 W' in vehicle.fly(400.0, 400.0, agile=True)['agile_power']


@pytest.mark.parametrize('gauge', [math.floor, round, math.ceil])
@pytest.mark.parametrize('share', [0.81, 1.0, 1.19])
@pytest.mark.parametrize('period', [0.2, 1.0, 9.0])
def test_a_power_within_a_fifth_is_never_told(gauge, share, period):
    assert not Vehicle(gauge=gauge, period=period).fly(800.0, share * 250.0)


def test_nothing_is_told_of_random_flights_as_planned():
    """Legs in either mode, climbs, other pilots, new batteries and gauges that step."""
    rng = random.Random(2)
    for _ in range(200):
        vehicle = Vehicle(gauge=rng.choice([math.floor, round, math.ceil]), start=rng.random())
        for _ in range(40):
            agile = rng.random() < 0.3
            power = rng.uniform(0.85, 1.15) * (400.0 if agile else 250.0)
            if vehicle.charge > 0.2:
                vehicle.fly(rng.uniform(1.0, 120.0), power, agile)
            match rng.randrange(5):
                case 0:
                    vehicle.use.interrupt()
                    vehicle.charge -= rng.uniform(0.0, 0.1)  # in a climb
                    vehicle.now += 30.0
                case 1:
                    vehicle.charge = rng.uniform(0.5, 1.0)  # another battery, unannounced
                case 2:
                    vehicle.charge -= 0.04  # a gauge that corrects itself
                case 3:
                    vehicle.now += 60.0  # silence
                    vehicle.charge -= 0.1
        assert not vehicle.use.warnings


def test_recharging_in_steps_is_no_flight():
    vehicle = Vehicle(start=0.3)
    for _ in range(20):
        vehicle.fly(30.0, 250.0)
        vehicle.charge += 0.05
    assert not vehicle.use.warnings


def test_too_short_a_flight_says_nothing():
    assert not Vehicle().fly(70.0, 300.0)
    assert not Vehicle().fly(10.0, 5_000.0)


# By the bridge's steps


def step(phase, charge, **battery):
    output = PilotOutput(phase, 'flies')
    return BridgeStep(output, {0: BatteryReading(charge, 12.0, 20.0, **battery)}, None, None, ())


def flown(energy, phase, command, power=500.0, **battery):
    """Fly for two minutes of the vehicle's own time; return what was told, step by step."""
    full, told = 5.0 * 14.8 * 3600.0, []
    action = parse_command(MISSION, command) if command else None
    for second in range(120):
        position = Position(0.0, 0.0, 0.0, 0.0, 20.0, boot_time=float(second))
        charge = math.floor(100.0 - 100.0 * power * second / full) / 100.0
        telemetry = Telemetry(position=position)
        told += energy.note(step(phase, charge, **battery), telemetry, action)
    return told


@pytest.mark.parametrize('phase', [Phase.EN_ROUTE, Phase.ON_SITE])
def test_a_vehicle_that_flies_as_commanded_is_heard(phase):
    energy = FlightEnergy(MISSION.energy)
    told = flown(energy, phase, 'commit goal1 normal')
    assert len(told) == 1
    assert told == list(energy.warnings)
    assert flown(FlightEnergy(MISSION.energy), phase, 'commit goal1 agile')[0].endswith(
        told[0].rpartition(' ')[2]
    )


@pytest.mark.parametrize(
    ('phase', 'command', 'battery'),
    [
        (Phase.PILOT, 'commit goal1 normal', {}),
        (Phase.CLIMBING, 'commit goal1 normal', {}),
        (Phase.GROUND, 'recharge', {}),
        (Phase.EN_ROUTE, '', {}),
        (Phase.EN_ROUTE, 'none normal', {'healthy': False}),
    ],
)
def test_all_else_is_not(phase, command, battery):
    assert not flown(FlightEnergy(MISSION.energy), phase, command, **battery)


def test_a_mission_without_energy_and_a_charge_that_is_not_known_say_nothing():
    assert not flown(FlightEnergy(None), Phase.EN_ROUTE, 'none normal')
    unknown = FlightEnergy(MISSION.energy)
    telemetry = Telemetry(position=Position(0.0, 0.0, 0.0, 0.0, 20.0))
    assert not unknown.note(step(Phase.EN_ROUTE, math.nan), telemetry, NONE)
