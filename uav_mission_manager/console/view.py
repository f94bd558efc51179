"""What the page shows of one vehicle, as plain values: made of what was heard, and of its age."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from uav_mission_manager.autopilot.task import Phase
from uav_mission_manager.console.heard import Heard, HeardDecision
from uav_mission_manager.console.words import (
    Fact,
    InCommand,
    authority,
    battery,
    closeness,
    fault,
    headline,
    link,
    staleness,
    threat,
)
from uav_mission_manager.mdp import Mission, action_name, global_actions

MOST_BARS = 12
"""Bars of actions, and of sub-MDPs, at most: a choice, of a mission of four goals all."""

UNSAID = Fact('')

PartValues = Sequence[tuple[tuple[int, ...], float]]
"""Goals, from 0, and share of the expected cost of each part of a policy."""


@dataclass(frozen=True)
class Bar:
    """A bar: its name, a value, its length 0 to 1, and what it is (`choice`, `second`, ..)."""

    name: str
    value: str
    length: float
    kind: str = ''


@dataclass(frozen=True)
class NowAndWhy:
    """The command and its reason.

    Attributes
    ----------
    headline : Fact
        The command in large words; its note says how old it is where it is old.
    reason : str
        One sentence.
    second : str
        The second best, and what it would cost more.
    share : str
        Which goal the base station of several vehicles gives it, and why; '' for none.
    closeness : Fact
        How far the policy is from the best possible.
    actions, parts : tuple of Bar
        The extra cost of each action that is allowed, and the share of each sub-MDP in the cost.
    forbidden : tuple of str
        Actions that are not allowed.
    dearer : int
        How many allowed actions have no bar, for they cost more than those that have one.
    """

    headline: Fact
    reason: str
    second: str = ''
    share: str = ''
    closeness: Fact = UNSAID
    actions: tuple[Bar, ...] = ()
    parts: tuple[Bar, ...] = ()
    forbidden: tuple[str, ...] = ()
    dearer: int = 0


@dataclass(frozen=True)
class VehicleView:
    """All that the page says of a vehicle in words.

    Attributes
    ----------
    name : str
    authority : InCommand
    facts : dict of str to Fact
        battery, link, fault and threat.
    now : NowAndWhy
    obstacle : str
        Why nothing can be ordered, '' where it can.
    """

    name: str
    authority: InCommand
    facts: dict[str, Fact]
    now: NowAndWhy
    obstacle: str


def view_of(
    name: str,
    heard: Heard,
    mission: Mission | None,
    parts: PartValues,
    now: float,
    timeout: float,
) -> VehicleView:
    """Return what to show.

    Parameters
    ----------
    name : str
    heard : Heard
    mission : Mission or None
        None where it is not known: the policy set is not at hand.
    parts : sequence of (goals, value)
    now, timeout : float
        Time, and age above which a thing is old [s].
    """
    facts = {
        'battery': battery(heard, mission, now, timeout),
        'link': link(heard, now, timeout),
        'fault': fault(heard, now, timeout),
        'threat': threat(heard, now, timeout),
    }
    in_command = authority(heard, now, timeout)
    card = _now_and_why(heard, mission, parts, now, timeout)
    return VehicleView(
        name=name,
        authority=in_command,
        facts=facts,
        now=replace(card, headline=_as_flown(card.headline, heard, in_command), share=heard.share),
        obstacle=obstacle(heard, now, timeout),
    )


def obstacle(heard: Heard, now: float, timeout: float) -> str:
    """Say why no order would reach the vehicle, '' if it would."""
    if old := staleness(heard.bridge, now, timeout):
        return f'the link is stale: bridge {old}'
    if heard.bridge and heard.bridge.value.phase == Phase.NO_LINK.value:
        return 'the link is lost: the bridge does not hear the autopilot'
    return ''


def _now_and_why(
    heard: Heard, mission: Mission | None, parts: PartValues, now: float, timeout: float
) -> NowAndWhy:
    if heard.decision is None:
        return NowAndWhy(Fact('NOTHING HEARD', 'stale', 'of the manager'), '')
    decision, old = heard.decision.value, staleness(heard.decision, now, timeout)
    reason = decision.reason.partition('; expected cost')[0]
    if not decision.command:
        return NowAndWhy(Fact('NO COMMAND', 'stale' if old else 'danger', old), reason)
    at_base = mission is not None and decision.state[-4] == mission.grid.base
    words = headline(decision.command, at_base)
    least = min(decision.values, default=math.nan)
    actions = action_bars(decision, mission)
    return NowAndWhy(
        headline=Fact(words, 'stale' if old else '', old or decision.command),
        reason=reason,
        second=_second(decision, actions),
        closeness=closeness(decision.lower_bound, decision.upper_bound, least),
        actions=actions,
        forbidden=tuple(
            name
            for name, value in zip(_action_names(decision, mission), decision.values)
            if not math.isfinite(value)
        ),
        dearer=sum(map(math.isfinite, decision.values)) - len(actions),
        parts=part_bars(parts, mission),
    )


def _as_flown(headline: Fact, heard: Heard, in_command: InCommand) -> Fact:
    """Say so where the vehicle is at work, and where someone else is in command."""
    if headline.tone:
        return headline
    if in_command.tone == 'good':
        goal = heard.bridge.value.goal_at_work if heard.bridge else ''
        there = goal and headline.note.startswith(f'commit {goal} ')
        return replace(headline, text=f'AT WORK AT {goal}') if there else headline
    if in_command.tone == 'stale':
        return Fact(headline.text, 'idle', f'{headline.note}: whether it is flown is not known')
    return Fact(headline.text, 'idle', f'{headline.note}: not flown, {in_command.word}')


def _second(decision: HeardDecision, actions: Sequence[Bar]) -> str:
    if not decision.runner_up:
        return 'nothing else is allowed'
    extra = next((bar.value for bar in actions if bar.kind == 'second'), f'{decision.margin:+.3g}')
    return f'second best: {decision.runner_up}, costs {extra}'


def action_bars(decision: HeardDecision, mission: Mission | None) -> tuple[Bar, ...]:
    """Return what allowed actions cost more than the best, in the order of their numbers.

    Of many the `MOST_BARS` best ones; the choice, which may be kept for a while, is one of them.
    """
    names, values = _action_names(decision, mission), decision.values
    allowed = [value for value in values if math.isfinite(value)]
    if not allowed:
        return ()
    best = sorted(allowed)[:MOST_BARS]
    least, most = best[0], best[-1]
    bars = []
    for name, value in zip(names, values):
        if not math.isfinite(value) or (value > most and name != decision.command):
            continue
        kind = {decision.command: 'choice', decision.runner_up: 'second'}.get(name, '')
        extra = value - least
        length = min(extra / (most - least), 1.0) if most > least else 0.0
        text = f'{value:.4g}' if extra == 0.0 else f'+{extra:.3g}'
        bars.append(Bar(name, text, length, kind))
    return tuple(bars)


def _action_names(decision: HeardDecision, mission: Mission | None) -> list[str]:
    """Name the actions; by their numbers where the mission is not known."""
    count = len(decision.values)
    if mission is not None and count == 2 * mission.k + 4:
        return [action_name(mission, action) for action in global_actions(mission)]
    return [f'action {number}' for number in range(1, count + 1)]


def part_bars(parts: PartValues, mission: Mission | None) -> tuple[Bar, ...]:
    """Return the share of sub-MDPs in the expected cost; of many the `MOST_BARS` largest ones."""
    if mission is None:
        return ()
    sizes = sorted((abs(value) for _, value in parts), reverse=True)[:MOST_BARS]
    most, least = (sizes[0], sizes[-1]) if sizes else (0.0, 0.0)
    return tuple(
        Bar(
            ' + '.join(mission.goals[goal].name for goal in goals) or 'common costs',
            f'{value:.4g}',
            abs(value) / most if most else 0.0,
        )
        for goals, value in parts
        if abs(value) >= least
    )
