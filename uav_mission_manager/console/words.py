"""What was heard in words and tones: who is in command, how old things are, what a command means.

A tone is what a style makes a colour of: '' as usual, `good`, `warning`, `danger`, `stale` (grey).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_mission_manager.autopilot.task import Phase
from uav_mission_manager.console.heard import Heard, HeardBridge, Noted
from uav_mission_manager.mdp import THREAT_LEVELS, Mission
from uav_mission_manager.mdp.epoch import SECONDS_PER_MINUTE
from uav_mission_manager.mdp.range_model import endurance, flight_range

AMPLE_RANGE = 2.0
"""Range over the way to the service cell below which the battery is a warning: a choice."""

UNKNOWN = 'unknown'


@dataclass(frozen=True)
class Fact:
    """Something to show: a large text with its tone, and a small one below."""

    text: str
    tone: str = ''
    note: str = ''


@dataclass(frozen=True)
class InCommand:
    """Who is in command: a word, its tone, why, and how the manager gets command back."""

    word: str
    tone: str
    why: str
    way_back: str


def age_text(seconds: float) -> str:
    """Return an age for people, such as `12 s` or `4 min`."""
    if seconds < 2 * SECONDS_PER_MINUTE:
        return f'{seconds:.0f} s'
    return f'{seconds / SECONDS_PER_MINUTE:.0f} min'


def staleness(noted: Noted[object] | None, now: float, timeout: float) -> str:
    """Say how old a thing is: '' where it is fresh, else `never heard` or `12 s old`."""
    if noted is None:
        return 'never heard'
    age = now - noted.at
    return '' if age <= timeout else f'{age_text(age)} old'


def authority(heard: Heard, now: float, timeout: float) -> InCommand:
    """Say who is in command."""
    bridge, old = heard.bridge, staleness(heard.bridge, now, timeout)
    if bridge is None:
        return InCommand('UNKNOWN', 'stale', 'the bridge was never heard', '')
    said = bridge.value
    if old:
        last = _in_command(said).word
        return InCommand('UNKNOWN', 'stale', f'{last} when last heard, {old}', '')
    return _in_command(said)


def _in_command(said: HeardBridge) -> InCommand:
    resume = 'Resume gives command back to the manager'
    if not said.link_up:
        return InCommand('NO LINK', 'danger', said.status, 'it goes on when the link is back')
    if said.phase == Phase.PILOT.value:
        who = 'AUTOPILOT' if 'failsafe' in said.status else 'PILOT'
        why = said.status.replace('; ~/resume gives command back', '')
        return InCommand(who, 'warning', why, f'when the pilot agrees, {resume}')
    if said.phase == Phase.HOLDING.value:
        return InCommand('ON HOLD', 'warning', said.status, resume)
    if said.phase == Phase.RETURNING.value:
        return InCommand('RETURNING', 'warning', said.status, resume)
    if said.phase in (Phase.BLOCKED.value, Phase.WAITING.value):
        return InCommand('BLOCKED', 'warning', said.status, 'nobody has taken command')
    return InCommand('MANAGER', 'good', said.status, '')


def battery(heard: Heard, mission: Mission | None, now: float, timeout: float) -> Fact:
    """Return the charge of the worst battery, with the minutes that it lasts."""
    if not heard.batteries:
        return Fact(UNKNOWN, 'stale', 'never heard')
    worst = min(heard.batteries.values(), key=lambda noted: noted.value)
    text, energy = f'{worst.value:.0%}', mission.energy if mission else None
    left = ''
    if energy is not None:
        left = f'{endurance(energy, worst.value) / SECONDS_PER_MINUTE:.1f} min left'
    if old := staleness(worst, now, timeout):
        return Fact(text, 'stale', old)
    if mission is None or energy is None or heard.pose is None:
        return Fact(text, '', left)
    service = mission.grid.position(mission.grid.service)
    way = math.dist((heard.pose.value.east, heard.pose.value.north), service)
    had = flight_range(energy, worst.value)
    if had < way:
        return Fact(text, 'danger', f'{left}; service is out of range')
    return Fact(text, 'warning' if had < AMPLE_RANGE * way else '', left)


def link(heard: Heard, now: float, timeout: float) -> Fact:
    """Return how the link is: of the vehicle's position, and what the bridge says of it."""
    bridge, pose = heard.bridge, heard.pose
    times = [noted.at for noted in (bridge, pose) if noted is not None]
    if not times:
        return Fact(UNKNOWN, 'stale', 'never heard')
    age = now - max(times)
    if age > timeout:
        return Fact(f'{age_text(age)} old', 'stale', 'nothing heard since')
    if bridge and not bridge.value.link_up:
        return Fact('LOST', 'danger', 'the autopilot is not heard')
    if old := staleness(pose, now, timeout):
        return Fact('NO POSITION', 'warning', old)
    return Fact('live', 'good', bridge.value.mode if bridge else 'no bridge heard')


def fault(heard: Heard, now: float, timeout: float) -> Fact:
    """Return what has failed."""
    if heard.fault is None:
        return Fact(UNKNOWN, 'stale', 'never heard')
    name = heard.fault.value
    text = 'none' if name == 'nominal' else name.replace('_', ', ')
    if old := staleness(heard.fault, now, timeout):
        return Fact(text, 'stale', old)
    return Fact(text, '' if name == 'nominal' else 'warning')


def threat(heard: Heard, now: float, timeout: float) -> Fact:
    """Return the threat that the manager reckons with, and what is heard of it if that differs."""
    said = heard.threat.value if heard.threat else ''
    state = heard.decision.value.state if heard.decision else ()
    if not state:
        return Fact(said or UNKNOWN, 'stale', 'the manager decides nothing')
    level = state[-2]
    text = THREAT_LEVELS[level]
    if old := staleness(heard.decision, now, timeout):
        return Fact(text, 'stale', old)
    if heard.threat is None:
        return Fact(text, TONES[level] or 'stale', 'assumed: never heard')
    return Fact(text, TONES[level], '' if said == text else f'heard: {said}')


TONES = ('', 'warning', 'danger')
"""Tone of each threat level, in the order of `THREAT_LEVELS`."""

HEADLINES = {
    'none normal': 'RETURN TO BASE',
    'none agile': 'EVADE TO BASE',
    'recharge': 'RECHARGE',
    'repair': 'GO FOR REPAIR',
}
"""Commands without a goal in large words."""


def headline(command: str, at_base: bool = False) -> str:
    """Return a command in large words, such as `GO TO goal2, EVADING`."""
    if at_base and command == 'none normal':
        return 'STAY AT BASE'
    if command in HEADLINES:
        return HEADLINES[command]
    name, _, mode = command.removeprefix('commit ').rpartition(' ')
    return f'GO TO {name}' + (', EVADING' if mode == 'agile' else '')


def closeness(lower: float, upper: float, cost: float) -> Fact:
    """Say how far the policy is from the best possible, by bounds and the cost it expects.

    The tone is `good` where that is proved.
    """
    if not (math.isfinite(lower) and lower > 0.0):
        return Fact('how good it is at best is not known', 'idle')
    proved = math.isfinite(upper)
    share, by = (upper if proved else cost) / lower - 1.0, '' if proved else ' by its own estimate'
    text = f'within {share:.1%} of the best possible{by}'
    if share < 5e-4:
        text = f'the best possible{by or ", proved"}'
    return Fact(text, 'good' if proved else '')
