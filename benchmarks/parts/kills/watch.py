"""What must be true of a chain however its processes die, checked from outside."""

from __future__ import annotations

import math
import sys
from collections import Counter
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String, UInt8MultiArray

from parts.kills.chain import NEAR, Chain
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, StateSpace
from uav_mission_manager.nodes import qos

EFFECT_TIME = 3.0
"""Time [s] after which what a person has asked for, or what has happened, is known everywhere: a
choice, well above the second after which states are repeated."""

ORDER_TIME = 1.0
"""Time [s] within which an order that was on its way may still show: a choice."""

REPEAT_TIME = 12.0
"""Time [s] within which a manager that did not hear of a completed goal is told again: that of the
bridge, and a little more. Meanwhile the vehicle stays there."""

DRIFT = 15.0
"""Distance [m] that a vehicle may move that holds: a choice, above what it needs to stop."""


class Watch:
    """Holds what people have asked for against what happens.

    Attributes
    ----------
    wanted : list of int
        Priority of each goal asked for and not achieved yet.
    asking : bool
        Whether a request is under way.
    requests : int
        How often the base station was asked and has not been heard to repeat it.
    held, taken : bool
        Whether ~/hold was answered; whether a pilot has command.
    broken : str
        The part of the vehicle that is broken and was seen to be, '' for none.
    violations : list of str
    counts : Counter
        What has happened.
    """

    def __init__(self, chain: Chain, clock: Any) -> None:
        self.chain, self._clock = chain, clock
        self.goals = [goal.name for goal in chain.mission.goals]
        self.wanted = list(chain.given) or [0] * len(self.goals)
        self.asking = self.held = self.taken = self.resuming = False
        self.broken, self.requests = '', 0
        self._asked: tuple[int, ...] = ()
        self._perhaps_done: set[int] = set()
        self.violations: list[str] = []
        self.counts: Counter[str] = Counter()
        self.command = self.fault = self.request = ''
        self.states: list[int] = []
        self._unwanted_since = [-math.inf] * len(self.goals)
        self._wanted_until = self._held_at = -math.inf
        self._manager_since = -math.inf
        self._before: dict[str, Any] = {}
        self._threats: set[str] = set()  # told since the manager was killed, or just before
        self._odd_states: list[tuple[float, list[int], list[int]]] = []
        self._decision: dict[str, str] = {}
        self._armed, self._mode = chain.armed, chain.mode
        self._anchor: tuple[float, float] | None = None
        self._near_at = [-math.inf] * len(self.goals)
        for topic, kind, profile, callback in (
            ('goal_priorities', UInt8MultiArray, qos.STATE_IN, self._on_priorities),
            ('goal_states', UInt8MultiArray, qos.LATCHED, self._on_states),
            ('goal_completed', String, qos.EVENT, self._on_completed),
            ('mission_command', String, qos.LATCHED, self._on_command),
            ('manager/decision', DiagnosticArray, qos.LATCHED, self._on_decision),
            ('fault_mode', String, qos.STATE_IN, self._on_fault),
        ):
            chain.listen(topic, kind, profile, callback)

    @property
    def now(self) -> float:
        """Time [s]."""
        return float(self._clock())

    def violate(self, text: str) -> None:
        """Note what must not be."""
        self.violations.append(text)
        self.tell(f'VIOLATION {text}')

    def tell(self, text: str) -> None:
        """Print what goes on."""
        print(f'{self.now:6.1f} s {self.chain.namespace}: {text}', file=sys.stderr, flush=True)

    # What people do

    def begin(self, values: tuple[int, ...]) -> None:
        """Count goals as being asked for: they, or those before, may be in force."""
        self.asking, self.requests, self._asked = True, 0, values
        self._perhaps_done = set()

    def ask(self, values: tuple[int, ...]) -> None:
        """Count goals as asked for; what was completed meanwhile may have been that already."""
        self._unwanted(any(values))
        self.wanted = [0 if g in self._perhaps_done else v for g, v in enumerate(values)]
        for goal, value in enumerate(self.wanted):
            if not value:
                self._unwanted_since[goal] = self.now

    def _unwanted(self, still: bool) -> None:
        if any(self.wanted) and not still:
            self._wanted_until = self.now

    def hold(self) -> None:
        """Count the vehicle as told to hold."""
        self.held, self._held_at, self._anchor = True, self.now, None

    # What happens

    def killed(self, name: str) -> None:
        """Remember what a node said last, for its successor to say the same."""
        self.counts[f'kills of {name}'] += 1
        if name == 'manager':
            self._before |= {'command': self.command, 'decision': self._decision}
            self._manager_since, self._threats = math.inf, {self.chain.told_threat}
        elif name == 'mavlink_bridge' and 'fault' not in self._before:
            self._before['fault'] = self.fault

    def step(self) -> None:
        """Look at the vehicle."""
        chain = self.chain
        self._threats.add(chain.threat)
        for goal in range(len(self.goals)):
            self._near(goal)
        if chain.armed and not self._armed:
            self.counts['take-offs'] += 1
            if why := self._why_not():
                self.violate(f'motors start though {why}')
        if self.taken and not self.resuming and chain.mode != self._mode != -1:
            self.violate(f'mode {self._mode} becomes {chain.mode} though a pilot has command')
        if self.held and chain.aloft and self.now - self._held_at > EFFECT_TIME:
            self._anchor = self._anchor or chain.position
            if math.dist(self._anchor, chain.position) > DRIFT:
                self.violate('moves though told to hold')
                self._anchor = None
        self._armed, self._mode = chain.armed, chain.mode
        self._odd_states = [entry for entry in self._odd_states if self._odd(*entry[1:])]
        while self._odd_states and self._odd_states[0][0] < self.now:
            _, before, states = self._odd_states.pop(0)
            self.violate(f'priorities {before} become {states}: nobody asked')
        for end in chain.ended:
            self.violate(end)
        chain.ended.clear()

    def _why_not(self) -> str:
        """Why motors must not start now, '' where they may."""
        if not any(self.wanted) and not self.asking and self.now - self._wanted_until > ORDER_TIME:
            return 'no goal is wanted'
        if self.held and not self.resuming and self.now - self._held_at > ORDER_TIME:
            return 'told to hold'
        if self.taken and not self.resuming:
            return 'a pilot has command'
        if self.broken and self.chain.far_from(self.chain.mission.grid.service) < NEAR:
            return f'the {self.broken} is broken'
        return ''

    def _on_priorities(self, message: UInt8MultiArray) -> None:
        label = message.layout.dim[0].label if message.layout.dim else ''
        if label != self.request:
            if not self.requests and self.request:
                self.violate(f'request {self.request} becomes {label}, nobody asked')
            if self.requests:
                self.requests -= 1
                self.ask(self._asked)
            self.request = label
            self.counts['requests'] += 1

    def _on_states(self, message: UInt8MultiArray) -> None:
        before, self.states = self.states or list(message.data), list(message.data)
        for goal, (was, now) in enumerate(zip(before, self.states)):
            if was and not now and self.wanted[goal] and self._near(goal):
                self._done(goal)  # Who is new may be heard by some, or die before it is by all.
        if self._odd(before, self.states):  # What explains it may come later, on another topic.
            self._odd_states.append((self.now + ORDER_TIME, before, self.states))

    def _odd(self, before: list[int], states: list[int]) -> bool:
        """Whether priorities change that nobody asked to change."""
        known = zip(states, before, self.wanted)
        return not self.asking and any(now not in (was, wanted) for now, was, wanted in known)

    def _on_completed(self, message: String) -> None:
        goal = self.goals.index(message.data)
        if self.asking:
            self._perhaps_done.add(goal)
        if self.wanted[goal]:
            self._done(goal)
        elif self.asking or not self._known(goal):
            self.counts['goals told again'] += 1
        else:
            self.violate(f'{message.data} is completed, unasked or again')

    def _done(self, goal: int) -> None:
        self.counts['goals done'] += 1
        self.wanted[goal] = 0
        self._unwanted_since[goal] = self.now
        self._unwanted(any(self.wanted))

    def _near(self, goal: int) -> bool:
        """Whether the vehicle is at a goal, or was: it may have left before that was heard."""
        if self.chain.far_from(self.chain.mission.goals[goal].cell) < NEAR:
            self._near_at[goal] = self.now
        return self.now - self._near_at[goal] < REPEAT_TIME

    def _known(self, goal: int) -> bool:
        """Whether the manager has had the time to hear that a goal is not wanted."""
        if goal in self._perhaps_done:
            return False
        since = max(self._unwanted_since[goal], self._manager_since)
        return self.now - since > (REPEAT_TIME if self._near(goal) else EFFECT_TIME)

    def _on_command(self, message: String) -> None:
        command, self.command = message.data, message.data
        first = self._manager_since == math.inf
        if first:
            self._manager_since = self.now
        for goal, name in enumerate(self.goals):
            unwanted = name in command.split() and not self.wanted[goal] and not self.asking
            if unwanted and self._known(goal):
                self.violate(f'{command}: not asked for, or done')
        self._compare()

    def _on_decision(self, message: DiagnosticArray) -> None:
        decision = {pair.key: pair.value for pair in message.status[0].values}
        if 'state' in decision:  # Else it decided nothing.
            self._decision = decision | {'reason': message.status[0].message}
            self._compare()

    def _compare(self) -> None:
        """Hold a manager's first command against the last one of the manager before it."""
        now, before = self._decision, self._before.get('decision', {})
        if not before or now is before or now.get('command') != self.command:
            return
        last = self._before['command']
        del self._before['decision'], self._before['command']
        space = StateSpace(self.chain.mission.k, self.chain.mission.grid.q)
        was, this = (space.split(_numbers(d['state'])) for d in (before, now))
        if THREAT_LEVELS[int(this.t)] not in self._threats | {THREAT_LEVELS[int(was.t)]}:
            self.violate(f'threat {int(was.t)} is {int(this.t)} after a restart')
        same = all(
            (getattr(was, name) == getattr(this, name)).all() for name in ('f', 'r', 'g', 'l', 't')
        )
        self.counts['first commands compared' if same else 'restarts into another state'] += 1
        over = before['reason'].startswith('keeps ') and self.command == before['runner_up']
        if same and self.command != last and not over:
            self.violate(f'{last} is {self.command} after a restart: {now["reason"]}')

    def _on_fault(self, message: String) -> None:
        before, self.fault = self._before.pop('fault', ''), message.data
        if self.broken and before and _parts(before) & ~_parts(self.fault):
            self.violate(f'fault mode {before} is {self.fault} after a restart')


def _parts(fault: str) -> int:
    return FAULT_MODES.index(fault)


def _numbers(text: str) -> Any:
    return np.array([int(word) for word in text.split()])
