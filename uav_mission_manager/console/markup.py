"""Parts of the page as HTML text; all that comes from outside is escaped."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

from uav_mission_manager.console.heard import LogLine
from uav_mission_manager.console.other_policy import OtherDecision
from uav_mission_manager.console.view import Bar, NowAndWhy, VehicleView
from uav_mission_manager.console.words import Fact, InCommand, headline

MOST_NAMED = 12
"""Actions that are named as not allowed, at most: a choice, three lines."""

Chances = Mapping[str, Mapping[int, float]]
"""Probability that each goal, by name, is done within so many minutes."""


def fact_html(name: str, fact: Fact) -> str:
    """A fact of the bar on top: its name, its value and a note."""
    return (
        f'<div class="fact {fact.tone}"><span class="label">{escape(name)}</span>'
        f'<span class="value">{escape(fact.text)}</span>'
        f'<span class="note">{escape(fact.note)}</span></div>'
    )


def authority_html(authority: InCommand) -> str:
    """Who is in command, as the largest word of the page."""
    why = escape('; '.join(filter(None, (authority.why, authority.way_back))))
    return (
        f'<div class="authority {authority.tone}" title="{why}"><span class="label">in command'
        f'</span><span class="word">{escape(authority.word)}</span>'
        f'<span class="note">{why}</span></div>'
    )


def top_html(view: VehicleView) -> str:
    """The bar on top of one vehicle."""
    facts = ''.join(fact_html(name, fact) for name, fact in view.facts.items())
    return (
        f'<div class="top"><div class="vehicle">{escape(view.name)}</div>'
        f'{authority_html(view.authority)}{facts}</div>'
    )


def tile_html(view: VehicleView, selected: bool) -> str:
    """A vehicle among several: what it does, its charge, and whatever is not as it should be."""
    battery, now = view.facts['battery'], view.now.headline
    parts = [(now.tone, now.text), (battery.tone, battery.text)]
    if view.authority.tone != 'good':
        parts.insert(0, (f'word {view.authority.tone}', view.authority.word))
    troubled = (view.facts[name] for name in ('link', 'fault', 'threat'))
    parts += [(fact.tone, fact.text) for fact in troubled if fact.tone in ('warning', 'danger')]
    words = ''.join(f'<span class="{tone}">{escape(text)}</span>' for tone, text in parts)
    chosen = ' selected' if selected else ''
    return f'<div class="tile{chosen}"><b>{escape(view.name)}</b>{words}</div>'


def now_html(now: NowAndWhy) -> str:
    """The command, its reason, and what else was possible."""
    head = now.headline
    share = f'<div class="share">fleet: {escape(now.share)}</div>' if now.share else ''
    return (
        f'<div class="now {head.tone}"><div class="headline">{escape(head.text)}</div>'
        f'<div class="note">{escape(head.note)}</div><div class="reason">{escape(now.reason)}'
        f'</div><div class="second">{escape(now.second)}</div>{share}'
        f'<div class="close {now.closeness.tone}">{escape(now.closeness.text)}</div></div>'
    )


def other_html(name: str, other: OtherDecision, at_base: bool) -> str:
    """What another policy would have done now, and what the difference is worth."""
    if not other.differs:
        lines = (
            f'<div class="headline">the same</div><div class="note">{escape(other.reason)}</div>'
        )
    else:
        words = headline(other.command, at_base) if other.command else 'NO COMMAND'
        lines = f'<div class="headline">{escape(words)}</div>'
        lines += f'<div class="reason">{escape(other.reason)}</div>'
        if other.flown_costs is not None and other.other_costs is not None:
            told = (
                f'by its values, what was flown {_extra(other.flown_costs)}; '
                f'by the values flown, this {_extra(other.other_costs)}'
            )
            lines += f'<div class="note">{escape(told)}</div>'
    kind = 'other differs' if other.differs else 'other'
    return f'<div class="{kind}"><h2>by {escape(name)}</h2>{lines}</div>'


def _extra(cost: float) -> str:
    if not math.isfinite(cost):
        return 'is not allowed'
    return f'costs {abs(cost):.3g} {"less" if cost < 0 else "more"}'


def bars_html(title: str, bars: Sequence[Bar]) -> str:
    """Bars with their names before and their values behind them."""
    if not bars:
        return ''
    rows = ''.join(
        f'<div class="bar {bar.kind}"><span class="name">{escape(bar.name)}</span>'
        f'<span class="track"><span class="fill" style="width:{100 * bar.length:.1f}%"></span>'
        f'</span><span class="amount">{escape(bar.value)}</span></div>'
        for bar in bars
    )
    return f'<div class="bars"><h2>{escape(title)}</h2>{rows}</div>'


def rest_html(forbidden: Sequence[str], dearer: int) -> str:
    """The actions without a bar, in a line or two."""
    lines = [f'{dearer} more cost more'] if dearer else []
    if forbidden:
        more = len(forbidden) - MOST_NAMED
        rest = f' and {more} more' if more > 0 else ''
        lines.append(f'not allowed: {", ".join(forbidden[:MOST_NAMED])}{rest}')
    return ''.join(f'<p class="rest">{escape(line)}</p>' for line in lines)


def forecast_html(chances: Chances | None, note: str) -> str:
    """Chances of goals in the next minutes; the note says of when, or why there are none."""
    if not chances:
        return f'<div class="forecast"><h2>forecast</h2><p class="note">{escape(note)}</p></div>'
    minutes = list(next(iter(chances.values())))
    heads = ''.join(f'<th>{limit} min</th>' for limit in minutes)
    rows = ''.join(
        f'<tr><td>{escape(goal)}</td>'
        + ''.join(f'<td>{_percent(share)}</td>' for share in shares.values())
        + '</tr>'
        for goal, shares in chances.items()
    )
    return (
        f'<div class="forecast"><h2>done within</h2><table><tr><th></th>{heads}</tr>{rows}</table>'
        f'<p class="note">{escape(note)}</p></div>'
    )


def _percent(share: float) -> str:
    """A probability that was counted: never certain, never impossible."""
    if share >= 0.995:
        return '&gt; 99%'
    return '&lt; 1%' if share < 0.005 else f'{share:.0%}'


def log_html(lines: Sequence[LogLine]) -> str:
    """The log, newest first."""
    rows = ''.join(
        f'<li class="{line.level}"><time>{escape(line.time_of_day)}</time>'
        f'<span>{escape(line.text)}</span></li>'
        for line in reversed(lines)
    )
    return f'<ol class="log">{rows}</ol>'
