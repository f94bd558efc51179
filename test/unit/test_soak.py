"""The soak benchmark's short form; and that each of its invariants would notice.

The chain is broken on purpose in most tests here: a bridge without its journal, a manager that
cannot wait. What is broken has to be found from outside.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20.ardupilotmega import (
    MAV_CMD_DO_SET_MODE,
    MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
)
from strategies import case_study

from uav_mission_manager.autopilot import bridge as vehicle_bridge
from uav_mission_manager.autopilot import telemetry
from uav_mission_manager.autopilot.flying import TaskFlight
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.messages import MESSAGE_BUILDERS
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode
from uav_mission_manager.autopilot.site import Site
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.nodes.flight_plan import FlightPlan
from uav_mission_manager.onboard import Situation
from uav_mission_manager.onboard.priority_request import PriorityRequest
from uav_mission_manager.onboard.trace import Replay, outcome_values
from uav_mission_manager.policy import build_policy

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'
SHORT_STORM = 200.0
"""Simulated time [s] of a storm here; the calm after it takes as long as it needs."""


@pytest.fixture(scope='module')
def soak():
    sys.path.insert(0, str(BENCHMARKS))
    names = ('chain', 'day', 'fate', 'invariants', 'leaks', 'whereabouts', 'work')
    yield SimpleNamespace(**{n: importlib.import_module(f'parts.soak.{n}') for n in names})
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope='module')
def policies(soak):
    mission = soak.work.with_work(mission_from_dict(case_study(), 'a mission'))
    other = replace(mission, distance_weight=2.0)
    return [build_policy(m, 'exact') for m in (mission, other)]


@pytest.fixture
def make_day(soak, policies, tmp_path):
    days = []

    def make(seed=0):
        folder = tmp_path / str(len(days))
        folder.mkdir()
        days.append(soak.day.Day(policies, folder, seed))
        return days[-1]

    yield make
    for process in (process for day in days for process in day.processes if process.up):
        process.kill()


@pytest.fixture
def day(make_day):
    """All work, the vehicle stands ready, and nothing happens by itself."""
    return ready(make_day())


def ready(day):
    day.ask(0, 0, 0)
    assert day.until(lambda: day.phase == 'on the ground' and not day.manager.problem, 60.0)
    day.spend(5.0)  # Requests settle.
    return day


def fly(day, *priorities):
    day.ask(*priorities)
    assert day.until(lambda: day.phase == 'en route', 60.0)


def restart(day, process, *, forgetful=False):
    day.kill(process)
    process.forgetful = forgetful
    day.start(process)


def violates(soak, invariant):
    return pytest.raises(soak.whereabouts.Violated, match=invariant)


@pytest.mark.parametrize('seed', range(2))
def test_all_holds_in_storms_and_calms(soak, make_day, seed):
    day = make_day(seed)
    soak.fate.Fate(day).run(SHORT_STORM)
    checked = day.invariants.checked
    assert min(checked['orders'], checked['commands'], checked['steps in the air']) > 10


def test_a_storm_is_decided_anew_from_its_record(soak, policies, tmp_path):
    entries = []

    def record(topic, text, now):
        entries.extend([text] if topic == 'manager/trace' else [])

    day = soak.day.Day(policies, tmp_path, 5, record)
    soak.fate.Fate(day, ['other policy']).run(SHORT_STORM)
    replay = Replay(policies[0])
    steps = [step for entry in entries for step in replay.take(entry)]
    for process in day.processes:
        process.kill()
    assert (replay.gaps, replay.skipped) == (0, 0)
    assert replay.runs > 1
    assert len(steps) > 100
    for step in steps:
        now = outcome_values(step.replayed)
        assert now == step.recorded or ('refused' in now and 'refused' in step.recorded)


def test_a_seed_replays(soak, make_day):
    days = [make_day(7), make_day(7)]
    for day in days:
        soak.fate.Fate(day).storm(100.0)
    assert list(days[0].log) == list(days[1].log)
    assert days[0].counts == days[1].counts
    assert days[0].vehicle.place == days[1].vehicle.place


def test_an_undisturbed_day_is_undisturbed(soak, day):
    fly(day, 1, 2, 0)
    for process in day.processes:
        day.spend(5.0)
        restart(day, process)
    assert day.until(lambda: not day.vehicle.airborne and day.counts['goals completed'] == 2, 300)


# Each invariant can fail


def test_a_bridge_that_forgets_who_took_over(soak, day):
    fly(day, 0, 2, 0)
    day.vehicle.tell(MAV_CMD_DO_SET_MODE, 1, SimulatedMode.LAND)
    assert day.until(lambda: not day.vehicle.flight.armed, 120.0)
    restart(day, day.bridge)
    day.spend(20.0)
    restart(day, day.bridge, forgetful=True)
    with violates(soak, 'never against a pilot'):
        day.spend(20.0)


def test_a_bridge_that_forgets_a_hold(soak, day):
    day.hold()
    day.ask(0, 2, 0)
    restart(day, day.bridge)
    day.spend(20.0)
    restart(day, day.bridge, forgetful=True)
    with violates(soak, 'held'):
        day.spend(20.0)


def test_a_bridge_that_does_not_wait_to_hear(soak, day, monkeypatch):
    fly(day, 0, 2, 0)
    monkeypatch.setitem(MESSAGE_BUILDERS, MAVLINK_MSG_ID_EXTENDED_SYS_STATE, lambda _: None)
    restart(day, day.bridge)
    day.spend(20.0)
    monkeypatch.setattr(telemetry, '_NEEDED', {})
    with violates(soak, 'hears before it orders: .* without EXTENDED_SYS_STATE'):
        day.spend(20.0)


def test_a_bridge_that_flies_for_no_goal(soak, day, monkeypatch):
    day.spend(20.0)
    monkeypatch.setattr(Site, 'may_stay', lambda *_: '')
    with violates(soak, 'flies only for a goal'):
        day.spend(20.0)


def test_a_bridge_that_does_not_land(soak, day, monkeypatch):
    task = FlightPlan.task
    monkeypatch.setattr(FlightPlan, 'task', lambda *a: replace(task(*a), land=False))
    monkeypatch.setattr(soak.invariants, 'HOMEWARD_TIME', 30.0)
    fly(day, 1, 0, 0)
    with violates(soak, 'flies only for a goal: in the air'):
        day.spend(120.0)


def test_a_bridge_that_completes_too_early(soak, day, monkeypatch):
    fly(day, 0, 2, 0)
    monkeypatch.setattr(TaskFlight, 'over', lambda *_: True)
    with violates(soak, 'done where it is'):
        day.spend(20.0)


def test_a_bridge_that_works_before_it_is_there(soak, day, monkeypatch):
    monkeypatch.setattr(TaskFlight, 'over', lambda *_: True)
    with violates(soak, 'done where it is: a picture, .* from goal1'):
        day.ask(1, 0, 0)
        day.spend(40.0)


def test_a_program_that_is_told_to_work_while_held(soak, day, monkeypatch):
    monkeypatch.setattr(Pilot, 'hold', lambda _: None)
    day.ask(0, 0, 2)
    assert day.until(lambda: day.bridge.core.output.active, 120.0)
    day.hold()
    with violates(soak, 'never against a pilot: the work of a program'):
        day.step()


@pytest.mark.parametrize(
    ('change', 'invariant'),
    [({'longitude': 149.1679}, 'on the grid'), ({'cruise_altitude': 640.0}, 'inside the fence')],
)
def test_a_bridge_that_flies_elsewhere(soak, day, monkeypatch, change, invariant):
    task = FlightPlan.task
    monkeypatch.setattr(FlightPlan, 'task', lambda *a: replace(task(*a), **change))
    with violates(soak, invariant):
        fly(day, 0, 2, 0)
        day.spend(60.0)


def test_an_autopilot_that_does_not_mind_its_fence(soak, day, monkeypatch):
    monkeypatch.setattr(SimulatedFlight, 'inside_fence', lambda *_: True)
    day.vehicle.flight.parameters['FENCE_RADIUS'] = 70.0
    with violates(soak, 'inside the fence: 70 m'):
        fly(day, 0, 2, 0)
        day.spend(30.0)


def test_a_bridge_that_is_silent_about_refusals(soak, day, monkeypatch):
    monkeypatch.setattr(AutopilotLink, 'refused', {})
    day.vehicle.flight.parameters['FENCE_RADIUS'] = 70.0
    with violates(soak, 'refusals are said'):
        fly(day, 0, 2, 0)
        day.spend(30.0)


def test_a_chain_that_forgets_what_is_done(soak, day, monkeypatch):
    fly(day, 0, 2, 0)
    monkeypatch.setattr(PriorityRequest, 'complete', lambda *_: False)
    assert day.until(lambda: day.counts['goals completed'], 120.0)
    day.spend(20.0)
    restart(day, day.manager)
    day.spend(20.0)
    restart(day, day.manager, forgetful=True)
    with violates(soak, 'nothing is done twice'):
        day.spend(60.0)


def test_a_goal_that_is_flown_to_again(soak, day, monkeypatch):
    fly(day, 0, 2, 0)
    assert day.until(lambda: day.counts['goals completed'], 120.0)
    day.spend(20.0)
    day.vehicle.flight.body.position = complex(0.0, 150.0)
    with violates(soak, 'nothing is done twice: goal2, done before'):
        day.completed('goal2')


def test_a_manager_that_does_not_dwell(soak, make_day, monkeypatch):
    nervous = replace(soak.chain.MANAGER_SETTINGS, settling_time=0.0, command_dwell=0.0)
    monkeypatch.setattr(soak.chain, 'MANAGER_SETTINGS', nervous)
    day = ready(make_day())
    fly(day, 0, 2, 0)

    def flicker():
        day.threat = 'none' if day.threat == 'high' else 'high'
        day.bus.threat.publish(day.threat, day.now)

    day.every_step = flicker
    with violates(soak, 'few commands'):
        day.spend(60.0)


def test_a_manager_that_does_not_mind_the_charge(soak, day, monkeypatch):
    fly(day, 0, 2, 0)
    monkeypatch.setattr(Situation, 'in_range', (1, 1, 1))
    day.vehicle.flight.body.battery.charge = 0.15
    with violates(soak, 'reserve: commit goal2'):
        day.spend(30.0)


def test_a_battery_that_is_empty_in_the_air(soak, day):
    fly(day, 0, 2, 0)
    day.vehicle.flight.body.battery.charge = 0.0
    with violates(soak, 'reserve: the battery is empty'):
        day.step()


def test_a_vehicle_that_falls_down(soak, day):
    fly(day, 0, 2, 0)
    day.vehicle.flight.disarm(force=True)
    day.vehicle.flight.armed = True
    day.vehicle.flight.parameters['SIM_ENGINE_MUL'] = 0.0
    day.vehicle.flight.parameters['SIM_ENGINE_FAIL'] = 15
    with violates(soak, 'no crash'):
        day.spend(20.0)


def test_a_manager_that_loses_what_is_wanted(soak, day, monkeypatch):
    monkeypatch.setattr(Situation, 'with_priorities', lambda self, *_: self)
    monkeypatch.setattr(soak.fate, 'CALM_LIMIT', 30.0)
    with violates(soak, 'no goal is lost'):
        soak.fate.Fate(day).calm()


def test_an_exception(soak, day, monkeypatch):
    def fail(*_):
        raise KeyError('of a bridge')

    monkeypatch.setattr(vehicle_bridge.VehicleBridge, 'warnings', property(fail))
    with pytest.raises(KeyError):
        day.spend(1.0)


@pytest.fixture
def leaks(soak, tmp_path):
    """A look-out for leaks that has seen two hours without any."""
    leaks = soak.leaks.Leaks(tmp_path)
    leaks.look(3601.0)
    leaks.look(7201.0)
    return leaks


def test_objects_that_grow_in_number(soak, leaks):
    kept = [[] for _ in range(leaks.samples[0].objects)]
    with violates(soak, 'no leak: .* objects'):
        leaks.look(10801.0)
    del kept


def test_a_journal_that_grows(soak, leaks, tmp_path):
    (tmp_path / 'a journal').write_bytes(bytes(1 << 20))
    with violates(soak, 'no leak: .* bytes of a journal'):
        leaks.look(10801.0)
