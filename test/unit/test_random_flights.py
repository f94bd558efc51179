"""Random missions in simulated flight, on days when everything happens."""

from __future__ import annotations

import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scenarios import NEEDED_BEFORE_AN_ORDER, PICTURE, Order
from simulated_chain import SimulatedChain
from strategies import case_study

from uav_mission_manager.autopilot.simulator.frames import MOTOR_FRAMES
from uav_mission_manager.mdp import Mission, mission_from_dict
from uav_mission_manager.policy import build_policy

MISSIONS = 12
BUSY_TIME = 150.0
"""Simulated time [s] in which goals are asked for and things go wrong."""

TO_FLY = (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF)


def random_task(rng: random.Random) -> dict[str, Any]:
    """Something to do at a goal."""
    return rng.choice(
        (
            {'dwell': rng.uniform(0.0, 20.0)},
            {'photo': {'count': rng.randint(1, 8), 'interval': rng.uniform(0.0, 3.0)}},
            {'external': {'timeout': rng.uniform(1.0, 20.0)}},
        )
    )


def random_mission(rng: random.Random, tasks: random.Random) -> Mission:
    """One or two goals in up to nine cells, anywhere on the earth."""
    rows, cols = rng.randint(2, 3), rng.randint(2, 3)
    goals = rng.randint(1, 2)
    document = case_study(*range(1, goals + 1))
    base, service, *cells = rng.sample(range(rows * cols), goals + 2)
    origin = {
        'latitude': rng.uniform(-70.0, 70.0),
        'longitude': rng.choice([rng.uniform(-179.0, 179.0), 179.9999, -179.9999]),
        'altitude': rng.uniform(0.0, 3000.0),
    }
    document['grid'] = {
        **{'rows': rows, 'cols': cols, 'base': base, 'service': service},
        **{'cell_size': rng.uniform(30.0, 60.0), 'origin': origin},
    }
    for goal, cell in zip(document['goals'], cells, strict=True):
        goal['cell'] = cell
        if tasks.random() < 0.7:
            goal['task'] = random_task(tasks)
    document['threat'].pop('zones')
    return mission_from_dict(document, 'a random mission')


class BadDay(SimulatedChain):
    """A crew that asks for goals, services the vehicle, and meets with faults at random."""

    def __init__(self, seed: int) -> None:
        rng = random.Random(seed)
        mission = random_mission(rng, random.Random(f'tasks {seed}'))
        frame = rng.choice(list(MOTOR_FRAMES.values()))
        super().__init__(build_policy(mission, method='exact'), seed=seed, frame=frame)
        self.rng = rng
        self.flight.body.position = complex(*reversed(mission.grid.position(mission.grid.base)))
        self.calm_since = self.now

    def watch_bridge(self, message) -> None:
        """Check each order when it is given."""
        before = len(self.orders)
        super().watch_bridge(message)
        for order in self.orders[before:]:
            self._check(order)
        if getattr(message, 'command', None) == PICTURE:
            assert self.phase == 'on site'

    def _check(self, order: Order) -> None:
        assert order.heard >= NEEDED_BEFORE_AN_ORDER, f'{order} after a gap'
        if order.number in TO_FLY and self._situation is not None:
            assert any(self._situation.priorities), f'{order}, and no goal is wanted'

    def happen(self) -> None:
        """Let something happen, and then be over."""
        sensors = self.lose_gps, self.lose_compass, self.lose_barometer
        others = self.cut_link, self.warn_of_battery, self.weaken_motor, self.reboot
        self.rng.choice((self.ask, self.ask, *sensors, *others))()
        for _ in range(self.rng.randint(20, 150)):
            self.spend(0.1)
            self.care()

    def ask(self) -> None:
        self.want(*(self.rng.randint(0, 2) for _ in self.mission.goals))

    def _outage(self, name: str, bad: float, good: float) -> None:
        self.set(name, bad)
        self.spend(self.rng.uniform(1.0, 15.0))
        self.set(name, good)

    def lose_gps(self) -> None:
        self._outage('SIM_GPS1_ENABLE', 0, 1)

    def lose_compass(self) -> None:
        self._outage('SIM_MAG1_FAIL', 1, 0)

    def lose_barometer(self) -> None:
        self._outage('SIM_BARO_DISABLE', 1, 0)

    def cut_link(self) -> None:
        self.cut()
        self.spend(self.rng.uniform(1.0, 30.0))
        if not self.bridge.link.up:  # A gap that nobody noticed is none.
            self.heard.clear()
        self.mend()

    def warn_of_battery(self) -> None:
        self.set('SIM_BATT_VOLTAGE', 10.3)

    def weaken_motor(self) -> None:
        self.set('SIM_ENGINE_MUL', 0.75)
        self.set('SIM_ENGINE_FAIL', 1)

    def reboot(self) -> None:
        if not self.armed:
            self.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
            self.spend(1.0)  # An order may be on its way.
            self.heard.clear()

    def care(self) -> None:
        """Do what a crew does for a vehicle that stands on the ground."""
        if self.armed:
            self.calm_since = self.now
        if self.now - self.calm_since < 3.0 or self.landed != 1:
            return
        if self.phase in ('pilot in command', 'holding'):
            self.resume()
        if self.flight.parameters['SIM_BATT_VOLTAGE']:
            self.set('SIM_BATT_VOLTAGE', 0)
        if self.flight.parameters['SIM_ENGINE_FAIL'] and self.command == 'repair':
            self.set('SIM_ENGINE_FAIL', 0)
        self.set('SIM_BATT_PCT', 100)

    def at_home(self) -> bool:
        """Whether it stands at its base, or at the service cell."""
        self.care()
        grid = self.mission.grid
        near = min(self.distance(grid.base), self.distance(grid.service))
        return not self.armed and near < grid.cell_size / 2.0 and abs(self.height) < 1.0


@pytest.mark.parametrize('seed', range(MISSIONS))
def test_it_flies_for_a_reason_hears_before_it_orders_and_comes_home(seed):
    day = BadDay(seed)
    day.until(lambda: day.ready and day.located, 'ready')
    end = day.now + BUSY_TIME
    while day.now < end:
        day.happen()
    day.want(*[1] * day.mission.k)
    day.until(lambda: day.at_home() or day.armed, 'up or still at home')
    day.spend(20.0)
    day.want(*[0] * day.mission.k)
    day.until(day.at_home, 'home', 300.0)
    day.spend(10.0)
    assert day.at_home()
    assert not any('Crash' in text for text in day.texts)
