"""What was heard of one vehicle, each thing with its time: immutable, changed by pure functions.

A thread that reads one `Heard` sees one moment, whatever arrives meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from uav_mission_manager.drawing.places import Point
from uav_mission_manager.drawing.trail import longer_trail
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import StateSpace
from uav_mission_manager.mdp.states import StateView

MOST_EPOCHS_KEPT = 1000
"""Epochs of the timeline, at most: a choice, two hours and more of a flight."""

MOST_LINES_KEPT = 200
"""Lines of the log, at most: a choice."""

T_co = TypeVar('T_co', covariant=True)


SHORTEST_STATE = 7
"""Variables of the state of a mission with one goal."""

CHARGE_LEVEL, IN_RANGE, PRIORITY = 'charge level', ' in range', ' priority'
"""Names of values of a decision: of the level b, and what ends those of each goal's range flag and
priority."""


@dataclass(frozen=True)
class Noted(Generic[T_co]):
    """A value, and when it was true [s]."""

    value: T_co
    at: float


@dataclass(frozen=True)
class Pose:
    """Where the vehicle is: east, north and height [m] in `map`, heading [rad] from north."""

    east: float
    north: float
    height: float
    heading: float


@dataclass(frozen=True)
class HeardDecision:
    """What the manager says on its topic `decision`.

    Attributes
    ----------
    state : tuple of int
        [f r.. g.. l c t m]; empty where it decided nothing.
    command : str
        Empty where it commands nothing.
    runner_up : str
        The second best command; empty if there is none.
    values : tuple of float
        Q of each action; inf where not allowed.
    margin, lower_bound, upper_bound : float
    digest : str
        Of the policy set.
    refused_goals : str
    reason : str
    levels : int
        Of the charge b in the state; 1 where it has range flags.
    in_range : tuple of int
        Range flag of each goal; empty where it is not told.
    goals : tuple of str
        Names of the goals in their order; empty where they are not told.
    """

    reason: str
    digest: str = ''
    refused_goals: str = 'none'
    state: tuple[int, ...] = ()
    command: str = ''
    runner_up: str = ''
    values: tuple[float, ...] = ()
    margin: float = math.inf
    lower_bound: float = math.nan
    upper_bound: float = math.inf
    levels: int = 1
    in_range: tuple[int, ...] = ()
    goals: tuple[str, ...] = ()

    @property
    def space(self) -> StateSpace:
        """The variables of its state; how many cells there are is not known."""
        return StateSpace.of_length(len(self.state), self.levels)

    @property
    def named(self) -> StateView:
        """The variables of its state by name."""
        return self.space.split(np.array(self.state))


@dataclass(frozen=True)
class HeardBridge:
    """What the bridge says of itself in the diagnostics.

    Attributes
    ----------
    phase : str
        Value of an `autopilot.task.Phase`.
    status : str
        Why, and all its warnings.
    link_up : bool
    mode : str
        Flight mode of the autopilot.
    armed : bool
    goal_at_work : str
        The goal at which it does what is to be done there, '' for none.
    """

    phase: str
    status: str
    link_up: bool
    mode: str
    armed: bool
    goal_at_work: str = ''


@dataclass(frozen=True)
class LogLine:
    """A line of the log: time of day, what happened, and how bad: '', `warning` or `danger`."""

    time_of_day: str
    text: str
    level: str = ''


@dataclass(frozen=True)
class HeardEpoch:
    """A decision that differs from the one before, as a column of the timeline."""

    number: int
    time_of_day: str
    decision: HeardDecision

    @property
    def state(self) -> tuple[int, ...]:
        """In which it was decided."""
        return self.decision.state

    @property
    def command(self) -> str:
        """What was commanded."""
        return self.decision.command


@dataclass(frozen=True)
class Heard:
    """All that was heard of one vehicle; None is never heard."""

    pose: Noted[Pose] | None = None
    trail: tuple[Point, ...] = ()
    batteries: Mapping[str, Noted[float]] = field(default_factory=dict)
    fault: Noted[str] | None = None
    threat: Noted[str] | None = None
    asked: Noted[tuple[int, ...]] | None = None
    decision: Noted[HeardDecision] | None = None
    bridge: Noted[HeardBridge] | None = None
    epochs: tuple[HeardEpoch, ...] = ()
    log: tuple[LogLine, ...] = ()
    policy_set: str = ''
    share: str = ''

    def with_pose(self, pose: Pose, at: float) -> Heard:
        """Return what is known with a position; one that is not a number is unknown."""
        if not all(map(math.isfinite, (pose.east, pose.north, pose.height))):
            return self
        trail = longer_trail(self.trail, (pose.east, pose.north))
        return replace(self, pose=Noted(pose, at), trail=trail)

    def with_battery(self, name: str, charge: float, at: float) -> Heard:
        """Return what is known with a charge from 0 to 1; all else is unknown."""
        if not 0.0 <= charge <= 1.0:
            return self
        return replace(self, batteries={**self.batteries, name: Noted(charge, at)})

    def with_decision(self, decision: HeardDecision, at: float, time_of_day: str) -> Heard:
        """Return what is known with a decision; one of a new kind begins an epoch."""
        heard = replace(self, decision=Noted(decision, at))
        before = _last_decision(self.epochs)
        same = (len(decision.state), decision.goals) == (len(before.state), before.goals)
        if decision.state and not same:
            heard = replace(heard, epochs=())  # Of another mission: its columns say nothing here.
        last = heard.epochs[-1] if heard.epochs else None
        if last and (last.state, last.command) == (decision.state, decision.command):
            return heard
        number = self.epochs[-1].number + 1 if self.epochs else 1
        epoch = HeardEpoch(number, time_of_day, decision)
        heard = replace(heard, epochs=(*heard.epochs, epoch)[-MOST_EPOCHS_KEPT:])
        if last and last.command == decision.command:
            return heard
        text, level = f'{decision.command}: {decision.reason}', ''
        if not decision.command:
            text, level = f'no command: {decision.reason}', 'warning'
        return heard.with_line(LogLine(time_of_day, text, level))

    def with_policy_set(self, path: str, time_of_day: str) -> Heard:
        """Return what is known with a policy set that was announced."""
        heard = replace(self, policy_set=path)
        return heard.with_line(LogLine(time_of_day, f'new policy set: {path}'))

    def with_share(self, words: str, time_of_day: str) -> Heard:
        """Return what is known with what the base station of several vehicles gives this one."""
        heard = replace(self, share=words)
        if self.share == words:
            return heard
        return heard.with_line(LogLine(time_of_day, f'fleet: {words}'))

    def with_bridge(self, bridge: HeardBridge, at: float, time_of_day: str) -> Heard:
        """Return what is known with the state of the bridge; a new phase is told."""
        heard = replace(self, bridge=Noted(bridge, at))
        last = self.bridge.value if self.bridge else None
        if last and (last.phase, last.link_up) == (bridge.phase, bridge.link_up):
            return heard
        level = '' if bridge.link_up else 'danger'
        return heard.with_line(LogLine(time_of_day, f'bridge: {bridge.status}', level))

    def with_line(self, line: LogLine) -> Heard:
        """Return what is known with a line of the log."""
        line = replace(line, text=shown(line.text, 300))
        return replace(self, log=(*self.log, line)[-MOST_LINES_KEPT:])

    def with_fault(self, name: str, at: float, time_of_day: str) -> Heard:
        """Return what is known with a fault mode; a new one is told."""
        heard = replace(self, fault=Noted(name, at))
        if self.fault and self.fault.value == name:
            return heard
        return heard.with_line(LogLine(time_of_day, f'fault mode {name}'))

    def with_threat(self, level: str, at: float, time_of_day: str) -> Heard:
        """Return what is known with a threat level; a new one is told."""
        heard = replace(self, threat=Noted(level, at))
        if self.threat and self.threat.value == level:
            return heard
        return heard.with_line(LogLine(time_of_day, f'threat heard: {level}'))

    def with_asked(self, priorities: tuple[int, ...], at: float, time_of_day: str) -> Heard:
        """Return what is known with the priorities that are asked for; new ones are told."""
        heard = replace(self, asked=Noted(priorities, at))
        if self.asked and self.asked.value == priorities:
            return heard
        text = ' '.join(map(str, priorities))
        return heard.with_line(LogLine(time_of_day, f'asked for: priorities {text}'))


def last_state(epochs: tuple[HeardEpoch, ...]) -> tuple[int, ...]:
    """The last state that was decided in; empty where there is none."""
    return _last_decision(epochs).state


def _last_decision(epochs: tuple[HeardEpoch, ...]) -> HeardDecision:
    decisions = (epoch.decision for epoch in reversed(epochs) if epoch.state)
    return next(decisions, HeardDecision(''))


def decision_from(message: str, values: Mapping[str, str]) -> HeardDecision:
    """Return what a status of the topic `decision` says.

    Raises
    ------
    ValueError
        If a number in it is none, or the state no state.
    """
    state = tuple(map(int, values.get('state', '').split()))
    levels = 1 + int(values.get(CHARGE_LEVEL, '0').split()[-1])
    space = StateSpace.of_length(len(state), levels)
    is_one = len(state) >= SHORTEST_STATE and state[-2] in range(3)
    if state and not (is_one and len(state) == len(space.names)):
        raise ValueError(f'state {state} is not f, r or b, g of each goal, l, c, t, m')
    told = tuple(int(v == 'yes') for name, v in values.items() if name.endswith(IN_RANGE))
    runner_up = values.get('runner_up', 'none')
    return HeardDecision(
        reason=shown(message, 400),
        digest=values.get('policy', ''),
        refused_goals=values.get('refused_goals', 'none'),
        state=state,
        command=values.get('command', ''),
        runner_up='' if runner_up == 'none' else runner_up,
        values=tuple(map(float, values.get('values', '').split())),
        margin=float(values.get('margin', 'inf')),
        lower_bound=float(values.get('lower_bound', 'nan')),
        upper_bound=float(values.get('upper_bound', 'inf')),
        levels=levels,
        in_range=told if levels > 1 else state[1 : 1 + space.k],
        goals=tuple(key[: -len(PRIORITY)] for key in values if key.endswith(PRIORITY)),
    )


def bridge_from(message: str, values: Mapping[str, str]) -> HeardBridge:
    """Return what the bridge's status in the diagnostics says."""
    return HeardBridge(
        phase=values.get('phase', ''),
        status=shown(message, 400),
        link_up=values.get('link') == 'up',
        mode=values.get('mode', ''),
        armed=values.get('armed') == 'True',
        goal_at_work=values.get('goal_at_work', ''),
    )
