"""`mission_report` of a flight: what it says is what the bag says, read here by other means.

`test/bags/case_study` is a flight of the demo, recorded by `mission_record`, eight times faster
than life; some topics are left out, positions and charges thinned.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from brute_force import BruteForce
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from uav_mission_manager.cli.mission_report import goals_done, main
from uav_mission_manager.cli.mission_report.flight_record import flight_record

ROOT = Path(__file__).parents[2]
BAG = ROOT / 'test' / 'bags' / 'case_study'
CASE_STUDY, CASE_ONE = (str(ROOT / 'policies' / name) for name in ('case_study', 'case_one'))
SPEEDUP = 8.0
STORE = get_typestore(Stores.ROS2_JAZZY)
ACTIONS = (
    *('none normal', 'commit goal1 normal', 'commit goal2 normal', 'commit goal3 normal'),
    *('none agile', 'commit goal1 agile', 'commit goal2 agile', 'commit goal3 agile'),
    *('recharge', 'repair'),
)
WORDS = {
    'none normal': ('STAY AT BASE', 'RETURN TO BASE', 'LAND AT BASE'),
    'none agile': ('EVADE TO BASE',),
    'recharge': ('RECHARGE',),
    'repair': ('GO FOR REPAIR',),
    **{f'commit goal{j} normal': (f'GO TO goal{j}',) for j in (1, 2, 3)},
    **{f'commit goal{j} agile': (f'GO TO goal{j}, EVADING',) for j in (1, 2, 3)},
}


class Page(HTMLParser):
    """The tables, words and tags of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.words: list[str] = []
        self._cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag == 'table':
            self.tables.append([])
        elif tag == 'tr':
            self.tables[-1].append([])
        elif tag in ('td', 'th'):
            self.tables[-1][-1].append('')
            self._cell = True
        elif tag == 'br' and self._cell:
            self.tables[-1][-1][-1] += '\n'

    def handle_endtag(self, tag: str) -> None:
        if tag in ('td', 'th'):
            self._cell = False

    def handle_data(self, data: str) -> None:
        self.words.append(data)
        if self._cell:
            self.tables[-1][-1][-1] += data

    def table(self, *heads: str) -> list[list[str]]:
        """The rows of the table with these heads among its own."""
        [found] = [table for table in self.tables if set(heads) <= set(table[0])]
        return found[1:]


def said(topic: str) -> list[tuple[float, Any]]:
    """Seconds of the flight, and messages of a topic of the recorded flight."""
    with Reader(BAG) as reader:
        found = [each for each in reader.connections if each.topic.endswith(topic)]
        return [
            ((time - reader.start_time) * 1e-9 * SPEEDUP, STORE.deserialize_cdr(m, c.msgtype))
            for c, time, m in reader.messages(found)
        ]


def decisions() -> list[tuple[float, dict[str, str], str]]:
    """Seconds, values and reason of each decision with a state."""
    found = [
        (at, {pair.key: pair.value for pair in message.status[0].values}, message.status[0])
        for at, message in said('manager/decision')
    ]
    return [(at, values, status.message) for at, values, status in found if 'state' in values]


def clock(seconds: float) -> str:
    return f'{round(seconds) // 60}:{round(seconds) % 60:02}'


def report(out: Path, source: Path | str, *options: str) -> str:
    assert main([str(source), '--out', str(out), *options]) == 0
    return out.read_text('utf-8')


@pytest.fixture(scope='module')
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp('report') / 'report.html'
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(goals_done, 'SIMULATION_SECONDS', math.inf)  # On a busy machine, too.
        return report(out, BAG, '--policy', CASE_STUDY, '--speedup', str(SPEEDUP))


@pytest.fixture(scope='module')
def page(text: str) -> Page:
    return Page(text)


def test_each_command_is_told_with_time_reason_second_best_and_cost(page: Page) -> None:
    rows = [row for row in page.table('what', 'why') if len(row) == 6]
    last, expected = '', []
    for at, values, reason in decisions():
        if values['command'] != last:
            expected.append((at, values, reason))
        last = values['command']
    assert len(rows) == len(expected) > 10
    for number, (row, (at, values, reason)) in enumerate(zip(rows, expected), 1):
        assert row[:2] == [clock(at), str(number)]
        assert row[2] in WORDS[values['command']]
        assert row[3].partition('\n')[0] == reason.split('; expected cost')[0]
        second, _, other = row[4].partition('; ')
        words, _, cost = second.rpartition(', ')
        same, margin = values['runner_up'].split()[:2], float(values['margin'])
        assert float(cost.removesuffix(' more')) == pytest.approx(margin, rel=5e-3)
        q = [float(value) for value in values['values'].split()]
        here = values['command'].split()[:2]
        if here[0] == 'commit' and here == same:
            assert (
                words == f'the same{" agile" if "agile" in values["runner_up"] else ", not agile"}'
            )
            others = {
                value: name
                for value, name in zip(q, ACTIONS)
                if math.isfinite(value) and name.split()[:2] != here
            }
            words, _, cost = other.rpartition(', ')
            assert words in WORDS[others[min(others)]]
            least = q[ACTIONS.index(values['command'])]
            assert float(cost) == pytest.approx(min(others) - least, rel=5e-3, abs=1e-3)
        else:
            assert words in WORDS[values['runner_up']]
            assert other == ''
        assert float(row[5]) == pytest.approx(min(q), rel=5e-4)
        assert q[ACTIONS.index(values['runner_up'])] - q[ACTIONS.index(values['command'])] == (
            pytest.approx(float(values['margin']), abs=1e-3)
        )


def test_the_story_is_in_order_and_has_what_was_heard(page: Page) -> None:
    rows = page.table('what', 'why')
    times = [
        60 * int(minutes) + int(rest) for minutes, rest in (row[0].split(':') for row in rows)
    ]
    assert times == sorted(times)
    events = [row[2] for row in rows if len(row) == 3]
    for topic, words in (('goal_completed', 'completed: '), ('threat_level', 'threat heard: ')):
        heard = [message.data for _, message in said(topic)]
        changes = [new for old, new in pairwise(['', *heard]) if topic[0] == 'g' or new != old]
        assert [e.removeprefix(words) for e in events if e.startswith(words)] == changes
    faults = [message.data for _, message in said('fault_mode')]
    changes = [new for old, new in pairwise(['', *faults]) if new != old]
    told = [e for e in events if e.startswith('fault mode') and 'counts' not in e]
    assert [f'fault mode {name}' for name in changes] == told
    assert 'asked for: goal2 high priority, goal3 low priority' in events
    assert len([e for e in events if e.startswith('took off')]) == 3
    assert len([e for e in events if e.startswith('landed')]) == 3
    assert not [each for each in events if 'still asked for' in each]  # It is told as completed.
    charges = [message.percentage for _, message in said('battery_state')]
    jumps = [(old, new) for old, new in pairwise(charges) if abs(old - new) >= 0.1]
    (fell, low), (empty, full) = jumps
    assert f'reported charge fell suddenly from {fell:.0%} to {low:.0%}' in events
    assert f'battery recharged or replaced: charge from {empty:.0%} to {full:.0%}' in events


def test_why_it_turned_back_is_in_the_first_lines(page: Page) -> None:
    words = ''.join(page.words)
    for command, how in (
        ('recharge', 'went to recharge, in the service cell already'),
        ('repair', 'went for repair'),
    ):
        [(at, reason)] = [
            (at, reason)
            for (_, before, _), (at, values, reason) in pairwise(decisions())
            if values['command'] == command != before['command']
        ]
        assert f'{clock(at)} It {how}: {reason.split("; expected")[0]}' in words
    fell = 'reported charge had fallen suddenly from 85% to 20%'
    assert f'{fell}. Second best: RETURN TO BASE, ' in words
    assert 'It went on to goal2, agile: threat high was heard.' in words
    assert 'It flew to base, agile: no goal is wanted, and threat high still counted.' in words
    first = clock(decisions()[0][0])
    assert f'Nobody took command from the manager, which commanded from {first} on.' in words


def test_goals_are_asked_for_begun_and_done_as_in_the_bag(page: Page) -> None:
    rows = page.table('goal', 'asked', 'begun', 'done')
    completed = [(message.data, clock(at)) for at, message in said('goal_completed')]
    assert sorted((row[0], row[4]) for row in rows) == sorted(completed)
    requests = [(at, list(message.data)) for at, message in said('goal_priorities')]
    for name, _, asked, begun, done, *_ in rows:
        j, end = int(name[-1]) - 1, seconds_of(done)
        raised = [at for (_, was), (at, now) in pairwise(requests) if now[j] > was[j] and at < end]
        assert asked.partition(', ')[0] == clock(raised[-1])
        first = next(
            at
            for at, values, _ in decisions()
            if raised[-1] <= at < end and values['command'].startswith(f'commit {name} ')
        )
        assert begun == clock(first)
        wanted = [
            at for at, v, _ in decisions() if at >= raised[-1] and int(v['state'].split()[4 + j])
        ]
        assert asked.endswith(f', counts from {clock(wanted[0])}') == (
            wanted[0] - raised[-1] > 8.0
        )
    assert [row[6] for row in rows if row[0] == 'goal1'] == ['0:30', '0:30']


def seconds_of(text: str) -> int:
    minutes, rest = text.split(':')
    return 60 * int(minutes) + int(rest)


@pytest.mark.parametrize(('took', 'slower'), [(9.0, '0% of them'), (1800.0, '100% of them')])
def test_how_many_simulated_flights_were_quicker(tmp_path: Path, took: float, slower: str) -> None:
    """No flight of the model is quicker than an epoch, and hardly one takes half an hour."""
    messages = [
        decided(0.0, 'commit goal1 normal', state='1 1 1 1 2 0 0 0 1 0 0'),
        string(took, '/uav1/goal_completed', 'goal1'),
        decided(took + 0.1),
    ]
    bag = bag_of(tmp_path / 'bag', messages)
    page = Page(report(tmp_path / 'r.html', bag, '--policy', CASE_STUDY))
    assert page.table('goal', 'slower than') == [
        ['goal1', 'high', '0:00', '0:00', clock(took), clock(took), '0:30', slower]
    ]


def test_energy_is_what_the_charge_says_and_what_the_mission_expects(page: Page) -> None:
    rows = page.table('took off', 'landed')[:-1]
    charges = [(at, message.percentage) for at, message in said('battery_state')]
    heights = [(at, message.pose.pose.position.z) for at, message in said('odom')]
    for row in rows:
        start, end = (60 * int(t.split(':')[0]) + int(t.split(':')[1]) for t in row[:2])
        assert all(z > 0.1 for at, z in heights if start + 5 < at < end - 5)
        first, last = (max(c for c in charges if c[0] <= at + 1)[1] for at in (start, end))
        assert float(row[4].split()[0]) == pytest.approx((first - last) * 5.0 * 14.8, abs=0.8)
        assert float(row[5].split()[0]) == pytest.approx(250.0 * (end - start) / 3600, abs=0.1)
    flown = sum(float(row[4].split()[0]) for row in rows)
    assert flown < 0.5 * 5.0 * 14.8  # What was taken out on the ground counts for no flight.


def test_what_was_paid_is_what_a_model_of_its_own_says(page: Page) -> None:
    """By the stage costs of the brute-force model, state by state as the bag has them."""
    manifest = json.loads((Path(CASE_STUDY) / 'manifest.json').read_text())
    model, discount = BruteForce(manifest['mission']), manifest['mission']['discount']
    found = decisions()
    start, (end, _) = found[0][0], max((m for m in said('')), key=lambda m: m[0])
    epochs = int((end - start) / 10.0)
    held = [[d for d in found if d[0] <= start + 10.0 * n][-1][1] for n in range(epochs + 1)]
    states = [tuple(map(int, values['state'].split())) for values in held]
    least = [min(map(float, values['values'].split())) for values in held]
    paid = sum(
        discount**n * model.cost(states[n], ACTIONS.index(held[n]['command']) + 1)
        for n in range(epochs)
    )
    left = discount**epochs * least[-1]
    rows = [float(row[1]) for row in page.tables[-2][1:]]
    assert rows == pytest.approx([least[0], paid, left, paid + left - least[0]], abs=0.02)
    assert f'paid in {epochs:,} epochs of 10 s' in page.tables[-2][2][0]
    surprises = [float(row[2]) for row in page.tables[-1][1:]]
    assert sum(surprises) == pytest.approx(rows[-1], abs=0.1)


def test_what_waited_is_told_with_how_long(page: Page) -> None:
    rows = [(row[0], row[2]) for row in page.table('what', 'why')]
    states = [(at, values['state'].split()) for at, values, _ in decisions()]
    for topic, place, words in (('threat_level', -2, 'threat none'), ('fault_mode', 0, None)):
        words = words or 'fault mode nominal'
        heard = [(at, message.data) for at, message in said(topic)]
        over = [at for (_, was), (at, now) in pairwise(heard) if now != was][-1]
        quiet = states[-1][1][place]
        at = [at for (_, was), (at, now) in pairwise(states) if now[place] == quiet != was[place]]
        text = f'{words} counts now: heard at {clock(over)}, {at[-1] - over:.0f} s before'
        assert (clock(at[-1]), text) in rows
    asked = next(at for at, message in said('goal_priorities') if any(message.data))
    counted = next(at for at, values, _ in decisions() if '1' in values['state'].split()[4:7])
    [request] = [text for _, text in rows if 'counts from' in text]
    assert request.endswith(f'; counts from {clock(counted)} on, {counted - asked:.0f} s later')
    kept = [(at, values) for at, values, _ in decisions() if float(values['margin']) < 0]
    flown = next(at for at, v, _ in decisions() if at > kept[0][0] and float(v['margin']) >= 0)
    [change] = [row for row in page.table('what', 'why') if 'a change of mind waits' in row[-3]]
    assert change[0] == clock(flown)
    assert f'decided {flown - kept[0][0]:.0f} s before; a change of mind waits' in change[3]
    charges = [(at, message.percentage) for at, message in said('battery_state')]
    full = next(at for (_, was), (at, now) in pairwise(charges) if now - was > 0.1)
    back = next(at for at, state in states if at > full and state[1:4] == ['1', '1', '1'])
    text = f'the new charge counts now: heard at {clock(full)}, {back - full:.0f} s before'
    assert (clock(back), text) in rows


def test_a_turn_without_news_has_the_values_before_and_after(page: Page) -> None:
    """Command 5 turns from goal 2 to goal 3, for the vehicle has come to cell 6."""
    at_turn = [i for i, (_, v, _) in enumerate(decisions()) if v['command'] == ACTIONS[3]]
    found = decisions()
    turn = next(i for i in at_turn if found[i - 1][1]['command'] == ACTIONS[2])
    (new_then, old_then), (new, old) = (
        [float(found[i][1]['values'].split()[j]) for j in (3, 2)] for i in (turn - 1, turn)
    )
    assert old_then < new_then
    assert new < old
    [row] = [row for row in page.table('what', 'why') if row[0] == clock(found[turn][0])]
    assert f'in cell {found[turn][1]["state"].split()[-4]} by now' in row[3]
    assert (
        f'this costs {new:.4g} from there, GO TO goal2 {old:.4g}; from cell '
        f'{found[turn - 1][1]["state"].split()[-4]} it was {new_then:.4g} and {old_then:.4g}'
    ) in row[3]


def test_where_it_took_off_and_why_though_it_was_to_recharge(page: Page) -> None:
    rows = [row for row in page.table('what', 'why') if len(row) == 3]
    told = [(row[0], row[2]) for row in rows if row[2].startswith(('took off', 'landed'))]
    assert [text for _, text in told] == [
        'took off in the base cell',
        'landed in the service cell',
        'took off in the service cell: begun for command 11, before 12 came',
        'landed in the service cell',
        'took off in the service cell',
        'landed in the base cell',
    ]
    commands = {row[1]: row for row in page.table('what', 'why') if len(row) == 6}
    assert commands['11'][2].startswith('GO TO')
    assert commands['12'][2] == 'RECHARGE'
    places = [(at, m.pose.pose.position) for at, m in said('odom')]
    start, end = map(seconds_of, (told[2][0], told[3][0]))
    hover = [place for at, place in places if start < at < end]
    assert max(math.dist((p.x, p.y), (50.0, 0.0)) for p in hover) < 25.0  # The service cell.


def test_in_the_base_cell_and_in_the_air_it_lands(page: Page) -> None:
    [row] = [row for row in page.table('what', 'why') if row[2] == 'LAND AT BASE']
    height = [m.pose.pose.position.z for at, m in said('odom') if at <= seconds_of(row[0])][-1]
    assert height > 2.0
    assert 'in the air: goes on to the base point and lands' in row[3]


def test_how_many_flights_cost_as_much_is_simulated(tmp_path: Path) -> None:
    """Of one epoch, in which a goal comes to be wanted; the share by the brute-force model."""
    from uav_mission_manager import load_policy

    policy = load_policy(CASE_STUDY)
    before, after = (1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0), (1, 1, 1, 1, 0, 0, 1, 0, 0, 0, 0)

    def told(at: float, state: tuple[int, ...]) -> Message:
        decision = policy.decide(state)
        command = ACTIONS[decision.action.number - 1]
        values = {'state': state, 'values': decision.values}
        return decided(at, command, **{k: ' '.join(map(repr, v)) for k, v in values.items()})

    bag = bag_of(tmp_path / 'bag', [told(0.0, before), told(9.0, after), told(11.0, after)])
    text = report(tmp_path / 'r.html', bag, '--policy', CASE_STUDY)
    manifest = json.loads((Path(CASE_STUDY) / 'manifest.json').read_text())
    model = BruteForce(manifest['mission'])
    states, chances = zip(*model.successors(before, 1))
    values = policy.q_values(list(states)).min(axis=1)
    least = min(policy.decide(after).values)
    share = float(np.array(chances)[values >= least * (1 - 1e-12)].sum())
    assert 0.02 < share < 0.5
    said = float(re.search(r'([\d.]+)% cost as much or more', text)[1]) / 100
    assert said == pytest.approx(share, abs=0.005 + 4 * math.sqrt(share * (1 - share) / 1000))


def test_no_policy_could_expect_less(text: str, page: Page) -> None:
    expected = float(page.tables[-2][1][1])
    bound = float(decisions()[0][1]['lower_bound'])
    assert bound == pytest.approx(expected, abs=0.01)
    assert f'No policy could have expected less than {bound:.2f} at the start.' in text


def test_what_is_left_out_of_the_surprises_weighs_less_than_what_is_shown(page: Page) -> None:
    rows = page.tables[-1][1:]
    costs = [abs(float(row[2])) for row in rows]
    assert rows[-1][1].endswith(' more')
    assert costs[-1] <= min(costs[:-1])
    slow = [row[1] for row in rows if 'slower than the mission assumes' in row[1]]
    assert [text.split(',')[0] for text in slow] == ['GO FOR REPAIR', 'RECHARGE']
    heard = {row[0] for row in page.table('what', 'why')}
    assert {row[0] for row in rows} - {''} <= heard  # One event has one time.


def test_the_legend_says_what_the_map_shows(text: str, page: Page) -> None:
    for words in ('base, where it starts', 'service, where it is recharged', 'threats likelier'):
        assert words in text
    assert 'of a simulation at 8 times the speed of life' in text
    assert 'policy set with fingerprint ' in text
    assert "5 s of the manager's clock, which are 40 s here" in ''.join(page.words)
    assert 'the worst of' not in text


def test_the_track_on_the_map_is_where_it_was(text: str) -> None:
    svg = next(s for s in re.findall(r'<svg.*?</svg>', text, re.S) if 'class="map"' in s)
    lines = re.findall(r'class="track" stroke="#\w+" points="([^"]*)"', svg)
    drawn = [tuple(map(float, p.split(','))) for line in lines for p in line.split()]
    flown = [(m.pose.pose.position.x, -m.pose.pose.position.y) for _, m in said('odom')]
    for place in flown:
        assert min(math.dist(place, point) for point in drawn) < 5.0
    for point in drawn:
        assert min(math.dist(place, point) for place in flown) < 0.1
    texts = re.findall(r'class="command-number"[^>]*>([^<]*)<', svg)
    numbers = [int(n) for text in texts for n in text.split(', ')]
    assert sorted(numbers) == list(range(1, len(numbers) + 1))


def test_it_is_one_file_without_scripts_or_network(text: str, page: Page) -> None:
    assert 'script' not in page.tags
    assert not {'link', 'img', 'iframe', 'object', 'use'} & set(page.tags)
    assert not {name for name, _ in page.attributes} & {'src', 'href', 'onload', 'onclick'}
    assert 'url(http' not in text
    assert "default-src 'none'; style-src 'unsafe-inline'" in text
    for svg in re.findall(r'<svg.*?</svg>', text, re.S):
        ElementTree.fromstring(svg)


def test_without_a_policy_set_it_tells_the_story_alone(tmp_path: Path, page: Page) -> None:
    text = report(tmp_path / 'r.html', BAG, '--speedup', '8')
    alone = Page(text)
    rows = [row[:2] for row in alone.table('what', 'why') if len(row) == 6]
    assert rows == [row[:2] for row in page.table('what', 'why') if len(row) == 6]
    [done] = [words for words in page.words if words.startswith('Done: goal1 at ')]
    assert done in alone.words
    assert 'Without --policy there is no map' in text
    assert 'class="map"' not in text
    assert 'What made the difference' not in text


def test_a_recording_faster_than_life_is_told(tmp_path: Path, text: str) -> None:
    hint = 'say so by --speedup'
    assert hint not in text
    assert hint in report(tmp_path / 'r.html', BAG, '--policy', CASE_STUDY)


def test_another_policy_set_of_the_mission_is_told(tmp_path: Path) -> None:
    from dataclasses import replace

    from uav_mission_manager import build_policy, load_policy

    mission = load_policy(CASE_STUDY).mission
    build_policy(replace(mission, distance_weight=2.0)).save(tmp_path / 'other')
    text = report(tmp_path / 'r.html', BAG, '--policy', str(tmp_path / 'other'))
    assert 'not the one that was flown' in text


Message = tuple[float, str, str, Any]
"""Seconds, topic, type, and what makes the message of the types of the store."""

TEXT, ARRAY = 'std_msgs/msg/String', 'diagnostic_msgs/msg/DiagnosticArray'


def string(at: float, topic: str, data: str) -> Message:
    return at, topic, TEXT, STORE.types[TEXT](data)


def status(at: float, topic: str, name: str, message: str, **values: str) -> Message:
    pairs = [STORE.types['diagnostic_msgs/msg/KeyValue'](*pair) for pair in values.items()]
    one = STORE.types['diagnostic_msgs/msg/DiagnosticStatus'](0, name, message, '', pairs)
    stamp = STORE.types['builtin_interfaces/msg/Time'](0, 0)
    header = STORE.types['std_msgs/msg/Header'](stamp, '')
    return at, topic, ARRAY, STORE.types[ARRAY](header, [one])


def decided(at: float, command: str = 'none normal', **values: str) -> Message:
    state = '1 1 1 1 0 0 0 0 0 0 0'
    known = {'state': state, 'command': command, 'values': '1 2 3 4 5 6 7 8 inf inf'}
    known |= {'runner_up': 'none', 'margin': 'inf', 'policy': 'abc'}
    return status(at, '/uav1/manager/decision', 'manager', 'because', **(known | values))


def named(last: str) -> dict[str, str]:
    """What a decision says of the goals, the last one of this name."""
    return {f'{goal} priority': 'none' for goal in ('goal1', 'goal2', last)}


def bridge(at: float, message: str, phase: str, **values: str) -> Message:
    known = {'link': 'up', 'phase': phase, 'armed': 'False', 'mode': 'GUIDED'}
    name = '/uav1/mavlink_bridge: autopilot'
    return status(at, '/diagnostics', name, message, **(known | values))


def bag_of(folder: Path, messages: Sequence[Message]) -> Path:
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in dict.fromkeys(each[1:3] for each in messages)
        }
        for at, topic, kind, message in messages:
            data = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], 10**18 + round(at * 1e9), bytes(data))
    return folder


def test_without_a_policy_a_flight_may_have_more_goals_in_the_end(tmp_path: Path) -> None:
    more = {'state': '1 1 1 1 1 0 0 0 2 0 4 0 0', 'values': '1 2 3 4 5 6 7 8 9 1 inf inf'}
    messages = [decided(0.0), decided(20.0, 'commit tree normal', **more), decided(40.0, **more)]
    bag, out = bag_of(tmp_path / 'bag', messages), tmp_path / 'report.html'
    assert main([str(bag), '--out', str(out)]) == 0
    assert 'GO TO tree' in out.read_text()


def test_takeovers_and_refusals_are_told(tmp_path: Path) -> None:
    messages = [
        decided(0.0),
        bridge(1.0, 'on the ground', 'on the ground'),
        bridge(61.0, 'the pilot chose LOITER; ~/resume gives command back', 'pilot in command'),
        bridge(75.0, 'en route', 'en route', command_refused='arming: not yet'),
        string(80.0, '/uav1/goal_refused', 'goal2'),
        string(90.0, '/uav1/goal_failed', 'goal3: no picture'),
        status(100.0, '/uav1/manager/decision', 'manager', 'link lost: odom 9.0 s old'),
    ]
    bag = bag_of(tmp_path / 'bag', messages)
    page = Page(report(tmp_path / 'r.html', bag, '--policy', CASE_STUDY))
    rows = [(row[0], row[2]) for row in page.table('what', 'why')]
    assert rows == [
        ('0:00', 'STAY AT BASE'),
        ('1:01', 'in command: PILOT: the pilot chose LOITER'),
        ('1:15', 'in command: MANAGER'),
        ('1:15', 'the autopilot refuses: arming: not yet'),
        ('1:20', 'out of reach: goal2'),
        ('1:30', 'task failed: goal3: no picture'),
        ('1:40', 'no command: link lost: odom 9.0 s old'),
    ]
    words = ''.join(page.words)
    assert 'PILOT from 1:01 to 1:15 (the pilot chose LOITER)' in words
    assert 'Out of reach, or failed: goal2 at 1:20, goal3: no picture at 1:30.' in words
    assert 'No battery was heard.' in words


HOSTILE = '</td><script>alert(1)</script>"&amp;\x1b[2J'


def test_what_comes_from_a_bag_is_escaped(tmp_path: Path) -> None:
    messages = [
        decided(0.0, HOSTILE, runner_up=HOSTILE, policy=HOSTILE),
        decided(1.0),
        bridge(2.0, HOSTILE, 'pilot in command', command_refused=HOSTILE),
        *(string(3.0, f'/uav1/{t}', HOSTILE) for t in ('goal_completed', 'goal_failed')),
        string(4.0, '/uav1/threat_level', HOSTILE),
    ]
    text = report(tmp_path / 'r.html', bag_of(tmp_path / '<b onload=x>', messages))
    assert 'script' not in Page(text).tags
    assert '<b onload' not in text
    assert '\x1b' not in text
    assert text.count('&lt;script&gt;') >= 6


def refusal(arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which the command ends."""
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    assert capsys.readouterr().out == ''
    line = str(end.value)
    assert line.startswith('mission_report: ')
    assert len(line.splitlines()) == 1
    return line


@pytest.mark.parametrize(
    ('make', 'options', 'words'),
    [
        (lambda _: 'nowhere', (), 'nowhere: there is no such bag'),
        (lambda _: ROOT / 'LICENSE', (), 'LICENSE: no bag'),
        (
            lambda _: BAG,
            ('--policy', CASE_ONE),
            'decided in another mission than case_one: a state has 7 variables',
        ),
        (lambda _: BAG, ('--policy', 'nowhere'), 'nowhere'),
        (lambda _: BAG, ('--namespace', '/uav9'), '--namespace: /uav9 is not in'),
        (lambda _: CASE_STUDY, ('--speedup', '8'), '--speedup: is for a bag'),
        (
            lambda folder: bag_of(folder / 'bag', [string(0.0, '/uav1/fault_mode', 'nominal')]),
            (),
            'no manager/decision in it, which mission_record records; it has /uav1/fault_mode',
        ),
        (
            lambda folder: bag_of(folder / 'bag', [decided(0.0, state='9 1 1 0 0')]),
            (),
            None,
        ),
        (
            lambda folder: bag_of(
                folder / 'bag', [decided(0.0), decided(2.0, state='9 1 1 1 0 0 0 0 0 0 0')]
            ),
            (),
            'at 2.00 s: manager/decision: state: (9, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0) has 9 where 1 '
            'to 8 may be',
        ),
        (
            lambda folder: bag_of(folder / 'bag', [decided(0.0, state='1 7 2 2 0 0 0 0')]),
            (),
            None,
        ),
        (
            lambda folder: bag_of(folder / 'bag', [decided(0.0, values='1 2')]),
            ('--policy', CASE_STUDY),
            'values: 2 numbers, not 10',
        ),
        (
            lambda folder: bag_of(
                folder / 'bag', [decided(0.0, **named('goal3')), decided(2.0, **named('tree'))]
            ),
            ('--policy', CASE_STUDY),
            'at 2.00 s: decided in another mission than case_study: goals: goal1, goal2, tree',
        ),
    ],
)
def test_what_cannot_be_reported_is_refused_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    make: Callable[[Path], Path | str],
    options: tuple[str, ...],
    words: str | None,
) -> None:
    out = tmp_path / 'report.html'
    out.write_text('the one before')
    arguments = [str(make(tmp_path)), *options, '--out', str(out)]
    if words is None:  # What is no decision is told in the report, as on the console's page.
        assert main(arguments) == 0
        assert 'is not f, r or b, g of each goal' in out.read_text()
        return
    assert words in refusal(arguments, capsys)
    assert out.read_text() == 'the one before'
    assert [each.name for each in tmp_path.iterdir() if each.name != 'bag'] == ['report.html']


def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal(['nowhere', '--out', str(tmp_path / 'no' / 'r.html')], capsys)
    assert line == f'mission_report: --out: there is no folder {tmp_path / "no"}'


@pytest.mark.parametrize('speedup', ['0', '-1', 'nan', 'inf', 'fast', '1001'])
def test_a_speedup_that_is_none_is_refused(
    speedup: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main([str(BAG), '--out', 'x.html', f'--speedup={speedup}'])
    assert end.value.code == 2
    assert f"'{speedup}' is not a number above 0, up to 1000" in capsys.readouterr().err


def test_it_needs_neither_ros_nor_matplotlib(tmp_path: Path) -> None:
    code = (
        'import sys\n'
        'for name in ("rclpy", "std_msgs", "matplotlib", "nicegui"): sys.modules[name] = None\n'
        'from uav_mission_manager.cli.mission_report import main\n'
        f'a, b = {str(tmp_path / "a.html")!r}, {str(tmp_path / "b.html")!r}\n'
        f'main([{str(BAG)!r}, "--policy", {CASE_STUDY!r}, "--out", a])\n'
        f'main([{CASE_ONE!r}, "--out", b])\n'
    )
    subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, check=True)
    assert {each.name for each in tmp_path.iterdir()} == {'a.html', 'b.html'}


def test_of_several_batteries_the_worst_is_drawn_and_said(tmp_path: Path) -> None:
    kind = 'sensor_msgs/msg/BatteryState'
    [first, *_] = said('battery_state')
    batteries = []
    for name in ('a', 'b'):
        values = {**vars(first[1]), 'location': name}
        values.pop('__msgtype__', None)
        batteries.append((1.0, '/uav1/battery_state', kind, STORE.types[kind](**values)))
    for count, words in ((1, 'Line: charge.'), (2, 'Line: the worst of 2 batteries.')):
        bag = bag_of(tmp_path / str(count), [decided(0.0), *batteries[:count]])
        assert words in report(tmp_path / 'r.html', bag)


def test_before_the_first_command_there_is_none_yet(tmp_path: Path) -> None:
    waiting = status(0.0, '/uav1/manager/decision', 'manager', 'waiting for data: odom')
    lost = status(9.0, '/uav1/manager/decision', 'manager', 'link lost: odom 4.0 s old')
    bag = bag_of(tmp_path / 'bag', [waiting, decided(1.0), lost])
    rows = Page(report(tmp_path / 'r.html', bag)).table('what', 'why')
    assert [row[2] for row in rows] == [
        'no command yet: waiting for data: odom',
        'RETURN TO BASE',
        'no command: link lost: odom 4.0 s old',
    ]


def test_of_a_short_bag_there_is_a_report_too(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / 'bag', [decided(0.0)])
    text = report(tmp_path / 'r.html', bag, '--policy', CASE_STUDY)
    assert 'it is shorter than an epoch' in text
    record = flight_record(bag, None)
    assert (record.end, record.legs, record.track, record.charges) == (0.0, [], [], [])
