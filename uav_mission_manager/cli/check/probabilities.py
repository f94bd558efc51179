"""Probabilities by which something always or never happens, and what never ends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np

from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.limits import LIMITS
from uav_mission_manager.mdp import THREAT_LEVELS, Mission
from uav_mission_manager.mdp.charge import range_table
from uav_mission_manager.mdp.dynamics import drain_probabilities
from uav_mission_manager.mdp.mission import Matrix

FEWEST_EPOCHS = 3
"""Epochs of flight that a full battery lasts for at the least: a choice, there and back."""


def probability_findings(mission: Mission) -> Iterator[Finding]:
    """Warn of what can never happen, must happen at once, or never ends."""
    yield from _requests(mission)
    yield from _failures(mission)
    yield from _completion(mission)
    yield from _range(mission)
    yield from _threat(mission)


def _requests(mission: Mission) -> Iterator[Finding]:
    for j, goal in enumerate(mission.goals):
        rows = goal.priority_transition
        field = f'goals.{j}.priority_transition (requests_per_hour)'
        if rows[0][0] == 0:
            text = 'a goal that is done is wanted again at once: no flight ever gets it done'
            yield Finding(field, rows[0], f'{text}; raise the first of these')
        elif rows[0][0] == 1:
            text = 'once done it is never expected to be wanted again'
            yield Finding(field, rows[0], text, note=True)
        for level in (1, 2):
            if rows[level][0] == 1:
                text = 'a request is withdrawn within an epoch, so none is ever worth a flight'
                yield Finding(field, rows[level], f'{text}; lower the first of these')


def _failures(mission: Mission) -> Iterator[Finding]:
    faults, rates = mission.faults, asdict(mission.faults.rate)
    limit = LIMITS['faults.agile_factor']
    for part, rate in rates.items():
        factor = getattr(faults.agile_factor, part)
        if rate == 1:
            text = 'it fails in the first epoch of every flight: give the chance of one epoch'
            yield Finding(f'faults.rate.{part} (mtbf)', rate, text)
        if not limit.hold(factor):
            text = f'not within {limit.low:g} to {limit.high:g} ({limit.reason}): 1 where unsure'
            yield Finding(f'faults.agile_factor.{part}', factor, text)
    if not any(rates.values()):
        text = 'nothing ever fails, so costs of faults and repairs mean nothing'
        yield Finding('faults.rate (mtbf)', 0.0, f'{text}; give a guess')
    elif faults.repair_success == 0:
        text = (
            'a part that has failed stays so for ever: above 0, 1 where a repair takes one epoch'
        )
        yield Finding('faults.repair_success (repair_in)', 0.0, text)


def _completion(mission: Mission) -> Iterator[Finding]:
    own = {f'goals.{j}': goal.completion for j, goal in enumerate(mission.goals)}
    found = {'faults': mission.faults.completion} if None in own.values() else {}
    found |= {where: completion for where, completion in own.items() if completion}
    for where, completion in found.items():
        field = f'{where}.completion (done_in)'
        if not any(completion):
            what = 'no goal can ever' if where == 'faults' else 'it can never'
            text = f'{what} be done: give the chance that an epoch on site completes it'
            yield Finding(field, completion, text)
        elif completion[0] == 0:
            text = 'is done with failed parts only, never with all in order: raise the first'
            yield Finding(f'{field}.0', 0.0, text)


def _range(mission: Mission) -> Iterator[Finding]:
    loss = mission.range.loss
    if loss is None:
        yield from _charge(mission)
        return
    for mode in ('normal', 'agile'):
        if getattr(loss, mode) == 1:
            text = 'every goal is out of range after an epoch of flight: give the chance of one'
            yield Finding(f'range.loss.{mode} (lasts)', 1.0, text)
    if loss.normal == loss.agile == 0:
        text = (
            'the battery lasts for ever, so nothing is ever recharged; give epoch over endurance'
        )
        yield Finding('range.loss (lasts)', 0.0, text)


def _charge(mission: Mission) -> Iterator[Finding]:
    levels = mission.range.levels
    for mode, row in zip(('normal', 'agile'), drain_probabilities(mission)):
        mean = float(row @ np.arange(levels))
        field = f'range.charge.drain.{mode} (noise)'
        if mean == 0:
            text = 'the battery lasts for ever, so nothing is ever recharged; give what is drained'
            yield Finding(field, 0.0, text)
        elif mean > levels / FEWEST_EPOCHS:
            text = f'an epoch of flight drains {mean:.3g} of {levels} levels: make cells smaller'
            yield Finding(field, mean, text)
    full = range_table(mission)[:, mission.grid.base, -1]
    for j in np.flatnonzero(~full).tolist():
        text = 'out of range from the base even when charged, for the reserve counts for no range'
        yield Finding(f'goals.{j}.cell', mission.goals[j].cell, text)


def _threat(mission: Mission) -> Iterator[Finding]:
    threat = mission.threat
    appears = {'threat.onset (per_hour)': threat.onset}
    appears |= {f'threat.zones.{cell} (zones_per_hour)': p for cell, p in threat.zones}
    for field, onset in appears.items():
        if onset == 1:
            text = 'a threat is there in every epoch: give the chance of one epoch'
            yield Finding(field, onset, text)
    if not any(appears.values()):
        text = 'no threat ever comes, so agile flight is pointless; give a guess'
        yield Finding('threat.onset (per_hour)', 0.0, text)
        return
    chain: Matrix = (
        (0.0, 1 - threat.high_share, threat.high_share),
        threat.from_low,
        threat.from_high,
    )
    for level in sorted(_reached(chain, 0) - {0}):
        if 0 not in _reached(chain, level):
            name = THREAT_LEVELS[level]
            text = 'such a threat never ends: raise the chance of none'
            yield Finding(f'threat.from_{name} (lasts)', chain[level], text)
    for level in {1, 2} - _reached(chain, 0):
        text = f'no threat is ever {THREAT_LEVELS[level]}: choose a share within 0..1'
        yield Finding('threat.high_share', threat.high_share, text)


def _reached(chain: Sequence[Sequence[float]], start: int) -> set[int]:
    """Levels that a chain may come to from one, in any number of epochs from 1."""
    found: set[int] = set()
    fresh = [start]
    while fresh:
        row = chain[fresh.pop()]
        new = {level for level, p in enumerate(row) if p > 0} - found
        found |= new
        fresh += new
    return found
