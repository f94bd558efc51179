"""Counts, posteriors and new mission files, against plain counting and the binomial."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import scipy
import yaml

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.learning import (
    Measured,
    count,
    effect,
    joined,
    simulated_epochs,
    with_counts,
    with_measured,
)
from uav_mission_manager.learning.mission_edit import Edit, edited, flow, probabilities
from uav_mission_manager.learning.posterior import (
    mean_posterior,
    probability_posterior,
    rate_posterior,
    row_posterior,
)
from uav_mission_manager.mdp import Mission, mission_from_dict
from uav_mission_manager.mdp.charge import drain_by_energy
from uav_mission_manager.mdp.energy import Charge, Range
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.solver.evaluation import (
    evaluate,
    representatives,
    simulate,
    start_state,
    starts_at_base,
    tabulate,
)
from uav_mission_manager.solver.submdp import whole_mission

FILE = Path(__file__).parents[2] / 'config' / 'case_study.yaml'
TEXT = FILE.read_text('utf-8')
MISSION = load_mission(FILE)
WRONG = {
    ('priority_transition',): [[0.8, 0.1, 0.1], [0.05, 0.9, 0.05], [0.05, 0.2, 0.75]],
    ('faults', 'rate'): {'sensor': 0.002, 'actuator': 0.004, 'camera': 0.03},
    ('faults', 'completion'): [1.0, 0.3, 0.3, 0.1, 0.0, 0.0, 0.0, 0.0],
    ('faults', 'repair_success'): 0.6,
    ('range', 'loss'): {'normal': 0.1, 'agile': 0.2},
    ('threat', 'onset'): 0.15,
    ('threat', 'zones'): {0: 0.0, 1: 0.0, 2: 0.05, 6: 0.05},
    ('threat', 'from_high'): [0.1, 0.2, 0.7],
}
"""Numbers that are off by factors of two to five."""
PHYSICAL = """
requests_per_hour: {low: 12.0, high: 6.0, raised: 9.0, withdrawn: 3.0}
faults:
  mtbf: {sensor: 0.3, actuator: 0.2, camera: 0.5}
  agile_factor: {sensor: 1.0, actuator: 2.5, camera: 1.0}
  repair_in: 20.0
  done_in: [15.0, 20.0, 30.0, 40.0, never, never, never, never]
  cost: [0.0, 4.0, 6.0, 12.0, 5.0, 9.0, 11.0, 18.0]
range: {lasts: {normal: 250.0, agile: 100.0}, cost: 3.0}
threat:
  per_hour: 20.0
  zones_per_hour: {2: 90.0}
  high_share: 0.4
  lasts: {low: 25.0, high: 20.0, rises: 0.3}
  cost: [[0.0, 2.0], [4.0, 3.0], [12.0, 4.0]]
"""
"""Sections in physical units, with epochs of 10 s."""


def physical_text() -> str:
    data = {**read_yaml(TEXT), **read_yaml(PHYSICAL)}
    del data['priority_transition']
    return yaml.safe_dump(data, sort_keys=False)


OWN_TIMES = (40.0, [20.0, 40.0, 50.0, 80.0, 'never', 'never', 'never', 'never'], None)
"""`done_in` of each goal; the last has that of `faults`."""


def own_times_text() -> str:
    data = yaml.safe_load(physical_text())
    for goal, done_in in zip(data['goals'], OWN_TIMES):
        if done_in is not None:
            goal['done_in'] = done_in
    return yaml.safe_dump(data, sort_keys=False)


def charged() -> Mission:
    drain = drain_by_energy(MISSION.energy, MISSION.grid.cell_size, 100, 0.2)
    charge = Charge(100, 0.1, drain, 200.0)
    return replace(MISSION, range=Range(3.0, charge=charge))


def flown(mission: Mission, flights: int, epochs: int, seed: int = 0, act=None):
    rng, rows = np.random.default_rng(seed), []
    simulate(
        mission,
        act or build_policy(mission, 'exact', 1e-3).act,
        starts_at_base(mission, flights, rng),
        epochs,
        rng,
        watch=lambda epoch: rows.append(simulated_epochs(mission, epoch)),
    )
    return joined(rows)


@pytest.fixture(scope='module')
def epochs():
    return flown(MISSION, 40, 60)


def test_each_time_of_its_own_is_learned_of_its_goal_alone():
    text, weight = own_times_text(), 10.0
    mission = mission_from_dict(read_yaml(text), 'flown')
    done = count(mission, flown(mission, 200, 60)).completion
    assert done[:, 0].min() > 0
    assert done[1:, 1:4].sum(axis=(1, 2)).min() > 0
    counts = count(mission, flown(mission, 200, 60))
    found = {e.field: e for e in with_counts(text, 'flown', counts, weight).learned}
    assert found['goals[0].done_in'].of == done[0, 0].sum()
    assert found['goals[1].done_in[2]'].seen == done[1, 2, 0]
    assert found['faults.done_in[0]'].of == done[2, 0].sum()
    for field, (yes, no) in {
        'goals[0].done_in': done[0, 0],
        'goals[1].done_in[0]': done[1, 0],
    }.items():
        old = 10.0 / found[field].old
        believed = (yes + weight * old) / (yes + no + weight)
        assert found[field].posterior.value == pytest.approx(10.0 / believed, rel=1e-2)


def test_no_time_is_rounded_below_an_epoch():
    data = yaml.safe_load(physical_text())
    data['energy']['speed'] = data['grid']['cell_size'] / (40.0 / 3)  # Epochs of 13.333.. s.
    data['faults']['done_in'][0], data['faults']['repair_in'] = 40.0 / 3, 20.0
    text = yaml.safe_dump(data, sort_keys=False)
    mission = mission_from_dict(read_yaml(text), 'flown')
    new = with_counts(text, 'flown', count(mission, flown(mission, 20, 30)), 10.0)
    done_in = next(e for e in new.learned if e.field == 'faults.done_in[0]')
    assert done_in.posterior.value == pytest.approx(40.0 / 3)
    assert 40.0 / 3 <= read_yaml(new.text)['faults']['done_in'][0] < 13.334


def test_counts_are_those_of_a_loop_over_the_states(epochs):
    k, seen = MISSION.k, Counter()
    for before, action, done, after, _ in zip(*(array.tolist() for array in epochs)):
        f, r, g = before[0], before[1 : 1 + k], before[1 + k : 1 + 2 * k]
        cell, threat = before[1 + 2 * k], before[3 + 2 * k]
        for j in range(k):
            if not done[j]:
                seen['priority', j, g[j], after[1 + k + j]] += 1
        if threat == 0:
            seen['onset', after[1 + 2 * k], after[3 + 2 * k]] += 1
        seen['threat', threat, after[3 + 2 * k]] += 1
        agile = int(k + 2 <= action <= 2 * k + 2)
        parked = action == 1 and cell == 0
        serviced = action > 2 * k + 2 and cell == MISSION.grid.service
        if not (parked or serviced):
            for bit in range(3):
                if not (f - 1) >> bit & 1:
                    seen['failure', agile, bit, 1 - ((after[0] - 1) >> bit & 1)] += 1
            for j in range(k):
                if r[j]:
                    seen['lost', agile, after[1 + j]] += 1
        if 2 <= action <= k + 1 or k + 3 <= action <= 2 * k + 2:
            goal = (action - 2) % (k + 1)
            if cell == MISSION.goals[goal].cell:
                seen['completion', goal, f - 1, 1 - done[goal]] += 1
        if action == 2 * k + 4 and serviced and f > 1:
            seen['repair', int(after[0] != 1)] += 1
    counts = asdict(count(MISSION, epochs))
    del counts['drain']  # There is no charge.
    for name, array in counts.items():
        for place, number in np.ndenumerate(array):
            assert number == seen[(name, *place)], (name, place)
    assert sum(array.sum() for array in counts.values()) == sum(seen.values())
    assert min(seen['repair', 0], seen['completion', 0, 0, 0], seen['lost', 1, 0]) > 0


def test_drains_are_counted_only_where_the_charge_tells_them():
    mission = charged()
    epochs = flown(
        mission, 5, 200, act=lambda states: np.full(len(states), 5)
    )  # Evade, all the time.
    known = max(map(len, vars(mission.range.charge.drain).values()))
    told = epochs.airborne & (epochs.states[:, 1] >= known)
    drained = Counter((epochs.states - epochs.after)[told, 1].tolist())
    counted = count(mission, epochs).drain
    assert counted.sum() == told.sum() < epochs.airborne.sum()
    assert {d: n for d, n in enumerate(counted[1]) if n} == drained
    assert counted[0].sum() == 0


def test_a_row_is_the_mean_of_its_dirichlet():
    found = row_posterior((0.9, 0.06, 0.04), (85, 9, 6), 2.0)
    epochs = 2.0 / 0.1  # 2 events that are not the likeliest one.
    expected = [(epochs * p + n) / (epochs + 100) for p, n in zip((0.9, 0.06, 0.04), (85, 9, 6))]
    assert [entry.value for entry in found] == pytest.approx(expected)


@pytest.mark.parametrize(('yes', 'no'), [(3, 17), (1, 400), (50, 50), (19, 1)])
def test_a_probabilitys_interval_is_clopper_and_pearsons(yes, no):
    low, high = probability_posterior(0.4, yes, no, 1.0)[1:]
    assert scipy.stats.binom.sf(yes - 1, yes + no, low) == pytest.approx(0.05)
    assert scipy.stats.binom.cdf(yes, yes + no, high) == pytest.approx(0.05)


def test_a_rates_interval_is_garwoods():
    value, low, high = rate_posterior(0.02, 4, 160.0, 3.0)
    assert scipy.stats.poisson.sf(3, 160 * low) == pytest.approx(0.05)
    assert scipy.stats.poisson.cdf(4, 160 * high) == pytest.approx(0.05)
    assert value == pytest.approx((3 + 4) / (3 / 0.02 + 160))


def test_what_was_never_seen_may_be_impossible_and_what_the_file_forbids_stays():
    never, always = row_posterior((0.0, 1.0), (0, 20), 3.0)
    assert (never.value, never.low, always.value, always.high) == (0, 0, 1, 1)
    assert never.high == pytest.approx(1 - 0.05 ** (1 / 20))  # P(none in 20) is 5 % there.
    assert rate_posterior(0.0, 0, 30.0, 3.0)[:2] == (0, 0)


def test_a_file_that_is_contradicted_is_worth_little():
    agreeing, contradicted = (rate_posterior(rate, 5, 500.0, 1.0) for rate in (0.008, 1e-5))
    assert agreeing.value == pytest.approx(6 / (125 + 500))
    assert contradicted.value == pytest.approx(5 / 501, rel=1e-4)
    row = row_posterior((1.0, 0.0), (4, 6), 3.0)
    assert row[0].value == pytest.approx((3 + 4) / 13)


def test_a_mean_has_students_interval():
    samples = np.array([240.0, 260.0, 250.0, 270.0])
    found = mean_posterior(255.0, samples, 1.0)
    reach = scipy.stats.ttest_1samp(samples, 0).confidence_interval(0.9).high - samples.mean()
    assert found.value == pytest.approx(255.0)
    assert found.high - found.value == pytest.approx(reach)


def test_intervals_hold_and_the_new_policy_wins_back_what_the_wrong_file_lost():
    wrong = edited(TEXT, 'wrong', [Edit(path, value, 'wrong') for path, value in WRONG.items()])
    truth, policy = read_yaml(TEXT), build_policy(mission_from_dict(read_yaml(wrong), ''), 'exact')
    hits = tries = 0
    for seed in range(12):
        counts = count(MISSION, flown(MISSION, 6, 60, seed, policy.act))
        new = with_counts(wrong, 'wrong', counts, 3.0)
        for estimate in new.learned:
            value = truth
            for part in estimate.path:
                value = value[part]
            hits += estimate.posterior.low <= value <= estimate.posterior.high
            tries += 1
    sub, start = whole_mission(MISSION), start_state(MISSION)
    before, best, after = (
        evaluate(sub, tabulate(sub, each.act), 1e-6).state_values(start)[0]
        for each in (policy, build_policy(MISSION, 'exact'), build_policy(new.mission, 'exact'))
    )
    assert hits / tries >= 0.9
    assert before - best > 0.05 * best  # There is something to win.
    assert (before - after) / (before - best) >= 0.8


def test_numbers_stay_in_the_units_of_the_file():
    """The same flights, told by a file in physical units and by one per epoch."""
    text = physical_text()
    mission = mission_from_dict(read_yaml(text), 'physical')
    counts = count(mission, flown(mission, 60, 120))
    new = with_counts(text, 'physical', counts, 3.0)
    per_epoch = with_counts(yaml.safe_dump(mission.to_dict()), 'epoch', counts, 3.0)
    data = read_yaml(new.text)
    assert set(data['faults']) == set(read_yaml(text)['faults'])
    assert set(data['threat']) == set(read_yaml(text)['threat'])
    assert data['faults']['done_in'][4:] == ['never'] * 4
    assert data['requests_per_hour']['raised'] != 9.0
    assert data['requests_per_hour'].get('lowered', 0.0) == 0.0
    for of in ('faults', 'range', 'threat'):
        both = [getattr(each.mission, of) for each in (new, per_epoch)]
        rows = [np.array(leaves(asdict(each)), float) for each in both]
        # Rates are gamma here and Dirichlet there, and differ by how an epoch's events are told.
        assert rows[0] == pytest.approx(rows[1], rel=0.06, abs=1e-3)
    pooled = counts.priority.sum(axis=0)
    low = new.mission.goals[0].priority_transition[0]
    assert low == pytest.approx(tuple(pooled[0] / pooled[0].sum()), rel=0.05)


def leaves(value) -> list[float]:
    if isinstance(value, dict):
        return [leaf for entry in value.values() for leaf in leaves(entry)]
    if isinstance(value, (list, tuple)):
        return [leaf for entry in value for leaf in leaves(entry)]
    return [] if value is None else [value]


@pytest.mark.parametrize('how', ['noise', 'drain', 'neither'])
def test_a_drain_is_learned_however_the_file_says_it(how):
    given = {'noise': ', noise: 0.3', 'drain': ', drain: {normal: [0.4, 0.6], agile: [1.0]}'}
    text = TEXT.replace(
        'loss: {normal: 0.04, agile: 0.10}',
        f'charge: {{levels: 40, empty_cost: 200.0{given.get(how, "")}}}',
    )
    mission = mission_from_dict(read_yaml(text), 'charge')
    counts = count(mission, flown(mission, 4, 60))
    drain = new = with_counts(text, 'charge', counts, 1.0)
    drain = new.mission.range.charge.drain
    n = counts.drain[0]
    assert n.sum() > 30
    mean = n @ np.arange(len(n)) / n.sum()
    assert np.dot(drain.normal, np.arange(len(drain.normal))) == pytest.approx(mean, rel=0.1)
    assert 'noise' not in read_yaml(new.text)['range']['charge']


def test_measured_speed_and_power_come_into_the_file():
    measured = Measured(np.full(4, 12.5), np.array([200.0, 210.0, 220.0]), np.array([300.0] * 3))
    new = with_measured(TEXT, 'case', measured, 1.0)
    energy = new.mission.energy
    assert energy.speed == pytest.approx(50.0 / ((10.0 + 4 * 12.5) / 5))
    assert energy.power == pytest.approx((250 + 630 + 900) / 7, rel=1e-5)
    few = with_measured(TEXT, 'case', Measured(np.array([12.5, 12.5])), 1.0)
    assert few.text == TEXT


def test_nothing_seen_changes_nothing():
    epochs = flown(MISSION, 1, 1)
    none = type(epochs)(*(array[:0] for array in epochs))
    new = with_counts(TEXT, 'case', count(MISSION, none), 3.0)
    assert (new.text, new.learned) == (TEXT, [])


def test_a_second_time_takes_the_place_of_the_first_comments(epochs):
    counts = count(MISSION, epochs)
    once = with_counts(TEXT, 'case', counts, 3.0).text
    twice = with_counts(once, 'case', counts, 3.0).text
    assert once.count('# learned') == twice.count('# learned') > 10
    rest = [line for line in twice.splitlines() if '# learned' not in line]
    assert len(rest) == len(TEXT.splitlines())
    assert [line.partition('#')[2] for line in rest] == [
        line.partition('#')[2] for line in TEXT.splitlines()
    ]


@pytest.mark.parametrize(
    ('text', 'path', 'value'),
    [
        ('{"a": {"b": 1.0, "c": [1, 2]}}', ('a', 'b'), 2.5),
        ('{"a": {"b": 1.0, "c": [1, 2]}}', ('a', 'c', 1), 1e-7),
        ('a:\n  b:\n    - 1\n    - 2   # two\n  c: 3\n', ('a', 'b'), [5, 6]),
        ('a:\n  b:\n    - 1\n    - 2   # two\n  c: 3\n', ('a', 'd'), 4.0),
        ('a: {}\n', ('a', 'd'), 4.0),
        ('a:\n- 1\n- 2\nb: 3\n', ('a',), [5, 6]),
        ('a:\n- {x: 1,\n   y: 2}\n- x: 3\n', ('a', 0, 'y'), 7.0),
        ('a:\r\n  b: 1\r\n', ('a', 'b'), 7.0),
        ('a: 1', ('a',), math.inf),
    ],
)
def test_a_value_is_changed_in_any_style(text, path, value):
    new = edited(text, 'x.yaml', [Edit(path, value, 'said')])
    found = read_yaml(new)
    for part in path:
        found = found[part]
    assert found == ('never' if value == math.inf else value)
    assert '# said' in new
    assert yaml.safe_load(new) == read_yaml(new)  # For readers of YAML 1.1, too.


def test_anchors_that_others_share_are_refused():
    text = 'a: &row [1.0, 2.0]\nb: *row\n'
    with pytest.raises(
        ValueError, match=r'x\.yaml: cannot be rewritten .* anchors, one of a\[0\]'
    ):
        edited(text, 'x.yaml', [Edit(('a', 0), 5.0, 'said')])


def test_a_row_sums_to_1_in_what_is_written():
    row = probabilities((1 / 3, 1 / 3 + 1e-10, 1 / 3))
    assert sum(row) == pytest.approx(1, abs=1e-12)
    assert read_yaml(flow(row)) == row


def test_the_effect_is_that_of_the_costs_in_every_state():
    old = mission_from_dict(
        read_yaml(edited(TEXT, '', [Edit(('range', 'loss', 'normal'), 0.3, '')])), ''
    )
    found, sub = effect(old, MISSION), whole_mission(MISSION)
    policies = [build_policy(mission, 'exact') for mission in (old, MISSION)]
    every = representatives(sub)
    actions = [policy.act(every) for policy in policies]
    assert found.changed == (actions[0] != actions[1]).sum() > 0
    assert found.states == len(every)
    values = [policy.q_values(every).min(axis=1) for policy in policies]
    start = (every == start_state(MISSION)).all(axis=1)
    assert found.new_cost == pytest.approx(values[1][start][0], abs=1e-5)
    assert found.expected == pytest.approx(values[0][start][0], abs=1e-5)
    assert found.old_cost > found.new_cost
    assert 0 < found.mean_loss < found.largest_loss
