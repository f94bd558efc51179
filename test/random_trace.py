"""Random flights of a manager, with their traces and what was decided in them."""

from __future__ import annotations

import json
import math
import random
from dataclasses import replace
from typing import Any

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Mission
from uav_mission_manager.mdp.placing import place_goal
from uav_mission_manager.onboard import (
    InputError,
    ManagerSettings,
    MissionManager,
    Refusal,
)
from uav_mission_manager.onboard.heard_input import CHANGES, EVENT_CHANGES, HeardInput
from uav_mission_manager.onboard.trace import TraceWriter
from uav_mission_manager.policy import Decision, Policy

STEPS = 1500


def some_input(rng: random.Random, now: float, goals: list[str]) -> HeardInput:
    """Anything that may be heard, some of it refused."""
    topic = rng.choice(
        ['battery_state', 'odom'] * 6 + [*['fault_mode'] * 3, *CHANGES, *EVENT_CHANGES]
    )
    if topic == 'battery_state':
        values = {
            'percentage': rng.choice([rng.uniform(0.3, 1.0), 0.97, math.nan, 1.1]),
            'healthy': rng.random() < 0.99,
            'voltage': rng.choice([math.nan, rng.uniform(14.0, 17.0)]),
            'current': rng.choice([math.nan, rng.uniform(-30.0, 1.0)]),
            'capacity': rng.choice([math.nan, rng.uniform(3.0, 10.0)]),
            'battery': rng.choice(['', 'id0', 'nan']),
        }
    elif topic == 'odom':
        values = {'east': rng.uniform(-40.0, 180.0), 'north': rng.uniform(-80.0, 40.0)}
    elif topic == 'goal_priorities':
        values = {
            'values': tuple(rng.choice([0, 1, 2, 2, 3]) for _ in goals),
            'request': rng.choice(['', 'nan', 'a', 'b']),
        }
    else:
        names = {
            'fault_mode': [*FAULT_MODES, *['nominal'] * 40],
            'threat_level': [*THREAT_LEVELS, *['none'] * 9],
        }
        values = {'name': rng.choice(names.get(topic, [*goals, 'nowhere']))}
    return HeardInput(topic, now - rng.choice([0.0, 0.3]), values)


class Recorded:
    """A manager's random flight: its trace, and what it decided at each step."""

    def __init__(self, policy: Policy, seed: int, other: Policy | None = None) -> None:
        self.rng = rng = random.Random(seed)
        self.now = rng.choice([0.1, 1e6 / 3])
        self.entries: list[str] = []
        self.outcomes: list[Decision | Refusal] = []
        settings = ManagerSettings(settling_time=rng.choice([0.0, 5.0]))
        self._begin(MissionManager(policy, settings))
        for _ in range(STEPS):
            self._go_on(policy, other)

    def _begin(self, core: MissionManager) -> None:
        self.core, self.trace = core, TraceWriter(core, self.now)

    def _go_on(self, policy: Policy, other: Policy | None) -> None:
        self.now += self.rng.choice([0.01, 0.05, 0.3])
        chance = self.rng.random()
        if chance < 0.002:  # It is killed, and goes on from its journal.
            memory = json.loads(json.dumps(self.core.memory))
            self._begin(MissionManager(policy, self.core.settings, memory))
        elif chance < 0.01:
            self.core.reset_goals()
            self.trace.reset()
        elif chance < 0.02:
            self.core.adopt(other or policy)
            self.trace.adopt()
        elif chance < 0.025:  # Somebody sets its parameters.
            times = {
                name: self.rng.choice([0.1, 1.0, 5.0])
                for name in ('input_timeout', 'command_dwell', 'settling_time')
            }
            self.core.adjust(replace(self.core.settings, **times))
            self.trace.adjust()
        else:
            goals = [goal.name for goal in policy.mission.goals]
            heard = some_input(self.rng, self.now, goals)
            try:
                self.core.take(heard)
                self.trace.hear(heard)
            except InputError:
                return
        if self.rng.random() < 0.9:
            self.outcomes.append(self.core.step(self.now))
            self.trace.step(self.now, self.outcomes[-1])
        if entry := self.trace.entry():
            self.entries.append(entry)


def take_over(
    mission: Mission, wanted: bool = True
) -> tuple[list[str], list[Decision | Refusal], list[Policy]]:
    """A flight in which a goal that is requested takes a slot: trace, outcomes, policies."""
    spare = replace(mission.goals[2], name='spare', cell=0, slot=True)
    before = replace(mission, goals=(*mission.goals[:2], spare))
    after, _ = place_goal(before, '{"cell": 6, "name": "tree"}', [2])
    policies = [build_policy(before), build_policy(after)]
    core = MissionManager(policies[0], ManagerSettings(command_dwell=0.0))
    trace, entries, outcomes = TraceWriter(core, 0.0), [], []
    for now in range(40):
        if now == 20:
            core.adopt(policies[1], wanted)
            trace.adopt(wanted)
        goals: dict[str, Any] = {'values': (0, 2, 0), 'request': 'a'}
        heard = [
            HeardInput('odom', float(now), {'east': 5.0 * now, 'north': 0.0}),
            HeardInput('battery_state', float(now), {'percentage': 0.95}),
            HeardInput('fault_mode', float(now), {'name': 'nominal'}),
            HeardInput('goal_priorities', float(now), goals),
        ]
        for each in heard:
            core.take(each)
            trace.hear(each)
        outcomes.append(core.step(float(now)))
        trace.step(float(now), outcomes[-1])
        entries.append(trace.entry())
    return entries, outcomes, policies
