"""Rates, durations and costs in physical units: what the model makes of them is what was meant."""

from __future__ import annotations

import math
import re
from collections import Counter

import numpy as np
import pytest
from chance import DRAWS, assert_drawn_from
from strategies import PARTS, UNITLESS, case_study, in_units, pick_states

from uav_mission_manager.mdp import (
    MissionError,
    StateSpace,
    dynamics,
    mission_from_dict,
    stage_costs,
)
from uav_mission_manager.mdp.mission_table import MISSION_TABLE
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.mdp.tables import Entries, Table
from uav_mission_manager.paths import share_directory

EPOCH = 10.0
"""Seconds of an epoch of `in_units`: cells of 50 m at 5 m/s."""

HOUR, MINUTE = 3600.0, 60.0


@pytest.fixture(scope='module')
def mission():
    return mission_from_dict(in_units(), 'test')


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def epochs_with_an_event(rng, per_hour):
    """In how many of DRAWS epochs one falls, of a process that waits exponentially for each."""
    times = np.cumsum(rng.exponential(HOUR / per_hour, int(DRAWS * EPOCH / HOUR * per_hour * 2)))
    assert times[-1] > DRAWS * EPOCH
    return len(np.unique((times[times < DRAWS * EPOCH] // EPOCH).astype(int)))


def assert_comes(rng, per_hour, probability):
    hit = epochs_with_an_event(rng, per_hour)
    counts = {True: hit, False: DRAWS - hit}
    assert_drawn_from(counts, {True: probability, False: 1 - probability})


def test_threats_come_as_often_as_a_poisson_process(mission, rng):
    assert_comes(rng, 12.0, mission.threat.onset)
    zones = dict(mission.threat.zones)
    assert_comes(rng, 90.0, zones[2])
    assert (zones[0], zones[1], zones[6]) == (0.0, 0.0, zones[2])


def test_parts_fail_after_their_mean_time(mission, rng):
    for part, hours in (('sensor', 50.0), ('actuator', 20.0), ('camera', 0.5)):
        assert_comes(rng, 1 / hours, getattr(mission.faults.rate, part))


REQUESTS = {0: {1: 6.0, 2: 3.0}, 1: {0: 1.0, 2: 4.0}, 2: {0: 1.0, 1: 2.0}}


@pytest.mark.parametrize('level', REQUESTS)
def test_requests_race_each_other(mission, rng, level):
    """Of events that each wait exponentially, the first in an epoch counts."""
    goals, waits = list(REQUESTS[level]), list(REQUESTS[level].values())
    at = rng.exponential(HOUR / np.array(waits), (DRAWS, len(waits)))
    first = np.where(at.min(axis=1) < EPOCH, np.array(goals)[at.argmin(axis=1)], level)
    row = mission.goals[1].priority_transition[level]
    assert_drawn_from(Counter(first.tolist()), dict(enumerate(row)))


def test_a_goals_own_requests_come_before_the_missions():
    document = in_units()
    document['goals'][1]['requests_per_hour'] = {'low': 0.0, 'high': 0.0}
    document['goals'][2]['priority_transition'] = case_study()['priority_transition']
    first, second, third = mission_from_dict(document, 'test').goals
    assert second.priority_transition == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert (
        third.priority_transition
        == mission_from_dict(case_study(), 'test').goals[2].priority_transition
    )
    assert first.priority_transition[0][0] < 1


def mean_time(transient):
    """Mean seconds in the states of an absorbing chain, from each of them."""
    transient = np.atleast_2d(transient)
    ones = np.ones(len(transient))
    return EPOCH * np.linalg.solve(np.eye(len(transient)) - transient, ones)


def test_threats_last_as_long_as_was_said(mission, rng):
    """A threat that goes from level to level as told, for exponential times, without epochs."""
    means, onward = np.array([25.0, 40.0]), np.array([0.3, 0.5])
    level = np.repeat([0, 1], DRAWS)
    total = np.zeros(2 * DRAWS)
    alive = np.ones(2 * DRAWS, bool)
    while alive.any():
        total += alive * rng.exponential(means[level])
        alive &= rng.random(2 * DRAWS) < onward[level]
        level = 1 - level
    simulated = total.reshape(2, DRAWS)
    error = simulated.std(axis=1) / math.sqrt(DRAWS)
    modelled = mean_time(dynamics.threat_matrices(mission)[3, 1:, 1:])
    assert (abs(modelled - simulated.mean(axis=1)) < 6 * error).all()


def test_a_duration_is_met_by_as_many_epochs_as_it_should(mission, rng):
    """Ends of epochs within a time that starts anywhere: in the mean as many as in the model."""
    start, lasts = rng.uniform(0, EPOCH, DRAWS), rng.exponential(600.0, DRAWS)
    met = np.floor((start + lasts) / EPOCH)
    error = met.std() / math.sqrt(DRAWS)
    assert abs(1 / mission.range.loss.normal - met.mean()) < 6 * error


def test_mean_times_are_kept(mission):
    faults = mission.faults
    for mode, seconds in (('normal', 600.0), ('agile', 240.0)):
        assert mean_time(1 - getattr(mission.range.loss, mode)) == pytest.approx(seconds)
    assert mean_time(1 - faults.repair_success) == pytest.approx(30.0)
    for f, seconds in enumerate((12.0, 15.0, 20.0, 40.0)):
        assert mean_time(1 - faults.completion[f]) == pytest.approx(seconds)
    assert faults.completion[4:] == (0.0,) * 4
    # Of the first goal with all in order; as many times longer with failed parts.
    for f, seconds in enumerate((25.0, 31.25, 25.0 * 20 / 12, 25.0 * 40 / 12)):
        assert mean_time(1 - mission.goals[0].completion[f]) == pytest.approx(seconds)
    assert mean_time(mission.discount) == pytest.approx(600.0)


def test_what_lasts_an_epoch_ends_with_it():
    document = in_units()
    document['faults']['done_in'] = [EPOCH] * 8
    assert mission_from_dict(document, 'test').faults.completion == (1.0,) * 8


def costs_of_a_minute(document, states, actions):
    return stage_costs(mission_from_dict(document, 'test'), states, actions) * (MINUTE / EPOCH)


@pytest.mark.parametrize('flag', [0, 1], ids=['out of range', 'in range'])
def test_worth_is_the_cost_of_a_goal_that_is_open_for_a_minute(mission, flag):
    """Nothing is failed, threatening or committed to, and all ranges are as they are."""
    states = [[1, *[flag] * 3, g, 0, 0, 3, 0, 0, 0] for g in (0, 1, 2)]
    nothing, low, high = costs_of_a_minute(in_units(), states, [1, 1, 1])
    assert (low - nothing, high - nothing) == pytest.approx((3.0, 6.0))


def test_costs_per_minute():
    document = case_study()
    mission = mission_from_dict(document, 'test')
    states = pick_states(StateSpace(mission.k, mission.grid.q), 500)
    actions = np.random.default_rng(1).integers(1, 11, len(states))
    given = stage_costs(mission, states, actions)
    document['costs_per'] = 'minute'
    assert costs_of_a_minute(document, states, actions) == pytest.approx(given)
    document['costs_per'] = 'epoch'
    mission = mission_from_dict(document, 'test')
    assert stage_costs(mission, states, actions).tolist() == given.tolist()


def test_a_mission_in_units_reads_back_per_epoch(mission):
    document = mission.to_dict()
    assert mission_from_dict(document, 'test') == mission
    assert not {'horizon', 'costs_per', 'requests_per_hour'} & document.keys()


def put(document, path, value):
    *above, last = path
    for key in above:
        document = document[key]
    document[last] = value


TWINS = [
    (('discount',), 0.9, 'horizon', 'discount'),
    (('priority_transition',), [[1, 0, 0]] * 3, 'requests_per_hour', 'priority_transition'),
    (('goals', 0, 'eta'), 1.0, 'goals[0].worth', 'goals[0].eta'),
    (('goals', 0, 'delta'), 1.0, 'goals[0].worth', 'goals[0].delta'),
    (('goals', 0, 'completion'), [1.0] * 8, 'goals[0].done_in', 'goals[0].completion'),
    (('faults', 'rate'), dict.fromkeys(PARTS, 0.1), 'faults.mtbf', 'faults.rate'),
    (('faults', 'repair_success'), 1.0, 'faults.repair_in', 'faults.repair_success'),
    (('faults', 'completion'), [1.0] * 8, 'faults.done_in', 'faults.completion'),
    (('range', 'loss'), {'normal': 0, 'agile': 0}, 'range.lasts', 'range.loss'),
    (('threat', 'onset'), 0.1, 'threat.per_hour', 'threat.onset'),
    (('threat', 'zones'), {2: 0.1}, 'threat.zones_per_hour', 'threat.zones'),
    (('threat', 'from_low'), [1, 0, 0], 'threat.lasts', 'threat.from_low'),
    (('threat', 'from_high'), [1, 0, 0], 'threat.lasts', 'threat.from_high'),
]


@pytest.mark.parametrize(('path', 'value', 'physical', 'per_epoch'), TWINS, ids=lambda x: str(x))
def test_one_thing_in_two_ways(path, value, physical, per_epoch):
    document = in_units()
    put(document, path, value)
    with pytest.raises(MissionError) as error:
        mission_from_dict(document, 'test')
    assert str(error.value) == (
        f'test: {physical}: is given besides {per_epoch}: keep one of them'
    )


def test_every_probability_per_epoch_has_a_twin():
    """Both in the list above, and in the document of these tests."""
    named = {path[-1] for path, *_ in TWINS}
    assert {key for keys in UNITLESS.values() for key in keys} | {'eta', 'delta'} == named


@pytest.mark.parametrize(
    ('path', 'value', 'says'),
    [
        (
            ('threat', 'per_hour'),
            360.0,
            'threat.per_hour: 360 an hour is a probability of 0.632 in an epoch of 10 s '
            '(50 m at 5 m/s), above 0.5: too coarse',
        ),
        (
            ('faults', 'mtbf', 'camera'),
            0.002,
            'faults.mtbf.camera: 500 an hour is a probability of 0.751 in an epoch of 10 s '
            '(50 m at 5 m/s), above 0.5: too coarse',
        ),
        (
            ('requests_per_hour', 'raised'),
            400.0,
            'requests_per_hour: 401 an hour is a probability of 0.672 in an epoch of 10 s '
            '(50 m at 5 m/s), above 0.5: too coarse',
        ),
        (
            ('threat', 'lasts', 'low'),
            9.5,
            'threat.lasts.low: 9.5 s is shorter than an epoch of 10 s (50 m at 5 m/s)',
        ),
        (
            ('faults', 'done_in'),
            [5.0] * 8,
            'faults.done_in: 5 s is shorter than an epoch of 10 s (50 m at 5 m/s)',
        ),
        *(
            (
                ('horizon',),
                horizon,
                f'horizon: {horizon:g} s is a discount of {discount} in an epoch of 10 s '
                '(50 m at 5 m/s), not within 0..1',
            )
            for horizon, discount in ((10.0, 0), (1e20, 1))
        ),
        (('horizon',), 9.0, 'horizon: 9 s is shorter than an epoch of 10 s (50 m at 5 m/s)'),
        (('horizon',), -1.0, 'horizon: -1.0 is not above 0'),
        (('faults', 'mtbf', 'sensor'), 0, 'faults.mtbf.sensor: 0 is not above 0'),
        (('faults', 'done_in'), [0.0] * 8, 'faults.done_in: 0.0 is not above 0, nor never'),
        (('threat', 'per_hour'), -1, 'threat.per_hour: -1 is negative'),
        (
            ('threat', 'zones_per_hour'),
            {8: 1.0},
            'threat.zones_per_hour.8: 8 is outside 0..7: no cell of the 2x4 grid',
        ),
        (
            ('threat', 'zones_per_hour'),
            {2: 900.0},
            'threat.zones_per_hour.2: 900 an hour is a probability of 0.918 in an epoch of 10 s '
            '(50 m at 5 m/s), above 0.5: too coarse',
        ),
        (('costs_per',), 'hour', "costs_per: 'hour' is none of epoch, minute"),
        (('energy', 'speed'), 1e-320, 'horizon: cannot be had per epoch of inf s'),
        (('goals', 0, 'worth'), 1e309, 'goals[0].worth: inf is not finite'),
    ],
    ids=lambda x: str(x)[:40],
)
def test_refused(path, value, says):
    document = in_units()
    put(document, path, value)
    with pytest.raises(MissionError) as error:
        mission_from_dict(document, 'test')
    assert str(error.value) == f'test: {says}'


def test_a_cost_that_no_number_can_hold():
    document = case_study(costs_per='minute', distance_weight=1e308)
    document['grid']['cell_size'] = 5000.0
    with pytest.raises(MissionError) as error:
        mission_from_dict(document, 'test')
    assert str(error.value) == (
        'test: distance_weight: 1e+308 a minute is too large for an epoch of 1000 s '
        '(5000 m at 5 m/s)'
    )


@pytest.mark.parametrize('path', [path for path, *_ in TWINS if path[-1] != 'delta'], ids=str)
def test_units_need_a_speed(path):
    """Each by itself, in a mission that is else per epoch."""
    document, source = case_study(), in_units()
    _, _, physical, _ = next(row for row in TWINS if row[0] == path)
    key = physical.rpartition('.')[2]
    holder = document
    for step in path[:-1]:
        holder, source = holder[step], source[step]
    for _, _, other, per_epoch in TWINS:
        if other == physical:
            holder.pop(per_epoch.rpartition('.')[2], None)
    holder[key] = source[key]
    mission_from_dict(document, 'test')
    del document['energy']
    with pytest.raises(MissionError) as error:
        mission_from_dict(document, 'test')
    message = str(error.value)
    assert re.match(rf'test: {re.escape(physical)}[.\w]*: needs energy\.speed, ', message)


def test_neither_way_is_told_as_the_first_missing():
    for section, keys in UNITLESS.items():
        for key in keys:
            document = case_study()
            if (document[section] if section else document).pop(key, None) is None:
                continue
            place = f'{section}.{key}'.strip('.') if key != 'priority_transition' else 'goals[0].'
            if key in ('zones', 'repair_success'):
                mission_from_dict(document, 'test')
                continue
            with pytest.raises(MissionError, match=rf'^test: {re.escape(place)}.*is missing$'):
                mission_from_dict(document, 'test')


@pytest.mark.parametrize(('cell_size', 'speed'), [(25.0, 5.0), (50.0, 10.0), (100.0, 8.0)])
def test_a_mission_stays_what_it_is_when_cells_or_speed_change(cell_size, speed):
    """Per hour and per second, threats and failures are as before."""
    document = in_units()
    document['grid']['cell_size'] = cell_size
    document['energy']['speed'] = speed
    document['faults']['done_in'] = [20.0] * 8
    document['threat']['zones_per_hour'] = {}
    mission = mission_from_dict(document, 'test')
    length = cell_size / speed
    none_in_an_hour = (1 - mission.threat.onset) ** (HOUR / length)
    assert none_in_an_hour == pytest.approx(math.exp(-12.0))
    assert length / mission.faults.completion[0] == pytest.approx(20.0)
    assert mission.goals[0].eta * (MINUTE / length) == pytest.approx(3.0)


PAGE = (share_directory() / 'docs' / 'mission_file.md').read_text('utf-8')


def test_the_worked_example_is_what_the_page_says():
    [text] = re.findall(r'^```yaml\n(name: .*?)^```', PAGE, re.MULTILINE | re.DOTALL)
    mission = mission_from_dict(read_yaml(text), 'page')
    rows = re.findall(r'^\| .* \| .* \| `([\w.]+)` ([\d.]+) \|$', PAGE, re.MULTILINE)
    assert len(rows) == 10
    for path, shown in rows:
        value = mission.to_dict()
        for key in path.split('.'):
            value = value[int(key) if isinstance(value, tuple | list) else key]
        assert value == pytest.approx(float(shown), rel=1e-4), path


def test_the_page_names_every_field():
    def names(table):
        for row in table.rows:
            yield row.key
            if isinstance(row.kind, Table | Entries):
                yield from names(row.kind if isinstance(row.kind, Table) else row.kind.table)

    fields = PAGE.partition('## Fields')[2].partition('## An epoch')[0]
    named = set(re.findall(r'\w+', ' '.join(re.findall(r'`([^`]+)`', fields))))
    assert set(names(MISSION_TABLE)) - named == set()
