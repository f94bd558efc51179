"""Forecasts against exact evaluation, and against a Markov chain written out state by state."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from brute_force import BruteForce, matrices
from strategies import CASE_STUDY, PARTS, case_study, lively

from uav_mission_manager import build_policy, load_mission, load_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.paths import share_directory
from uav_mission_manager.solver.evaluation import evaluate, flights, starts_at_base, tabulate
from uav_mission_manager.solver.evaluation.flights import fly
from uav_mission_manager.solver.evaluation.forecast import (
    difference,
    epochs_within,
    forecast,
    forecast_epochs,
)
from uav_mission_manager.solver.submdp import whole_mission

POLICIES = share_directory() / 'policies'
WILD = Path(__file__).parents[1] / 'missions' / 'wild.yaml'


def exact_cost(policy, start):
    sub = whole_mission(policy.mission)
    return float(evaluate(sub, tabulate(sub, policy.act)).state_values(start)[0])


def assert_cost_agrees(policy, start, episodes=4000, seed=1):
    rows = np.repeat(start, episodes, axis=0)
    flown = fly(policy.mission, policy.act, rows, 1, np.random.default_rng(seed))
    found = _cost_of(flown)
    value, rounding = exact_cost(policy, start), 1e-8 * (1 + abs(found.value))
    assert found.low - rounding <= value <= found.high + rounding


def _cost_of(flown):
    """The forecast's cost, of a mission that may have no energy."""
    energy = load_mission(CASE_STUDY).energy
    return forecast(replace(flown, mission=replace(flown.mission, energy=energy))).cost


SHIPPED = {
    'case_study': lambda: load_policy(POLICIES / 'case_study'),
    'case_one': lambda: load_policy(POLICIES / 'case_one'),
    'wild': lambda: build_policy(load_mission(WILD), 'split'),
    'lively': lambda: build_policy(mission_from_dict(lively(), 'test'), 'exact'),
    'lively, as in the paper': lambda: build_policy(
        mission_from_dict(lively(feasibility='paper'), 'test'), 'highest_priority'
    ),
}


@pytest.mark.parametrize('name', SHIPPED)
def test_cost_agrees_with_exact_evaluation(name):
    policy = SHIPPED[name]()
    start = policy.space.check([1, *[1] * policy.mission.k, *[2] * policy.mission.k, 0, 0, 0, 0])
    assert_cost_agrees(policy, start)


@pytest.mark.parametrize('seed', range(5))
def test_cost_agrees_in_random_missions(seed):
    """No chance in them is so rare that a thousand flights may not show it."""
    rng = np.random.default_rng(seed)
    document = lively(discount=rng.uniform(0.5, 0.95), distance_weight=rng.uniform(0, 9))
    document['priority_transition'] = rng.dirichlet((1, 1, 1), 3).tolist()
    document['faults']['completion'] = rng.uniform(0.1, 1, 8).tolist()
    document['faults']['cost'] = rng.uniform(0, 20, 8).tolist()
    mission = mission_from_dict(document, 'test')
    start = starts_at_base(mission, 1, rng)
    assert_cost_agrees(build_policy(mission, 'exact'), start)


FULL = 30
"""Epochs in the air that a full battery gives."""


def one_goal():
    """A mission of one goal in which everything happens within half an hour."""
    document = lively()
    del document['goals'][1]
    document['faults']['completion'] = [0.05, 0.03, 0.04, 0.01, 0.0, 0.0, 0.0, 0.0]
    document['range']['loss'] = {'normal': 0.1, 'agile': 0.3}
    document['faults']['rate'] = {'sensor': 0.01, 'actuator': 0.02, 'camera': 0.005}
    # FULL epochs of 10 s at 3.6 W take 0.01 Wh each.
    document['energy'] |= {'capacity': 0.01 * FULL, 'voltage': 1.0, 'power': 3.6}
    return document


START = (1, 1, 2, 0, 0, 0, 0)
EPOCHS = 180
ROUNDING = 1e-9


class Chain:
    """The chain of a policy, enumerated: transitions, and which of them complete the goal."""

    def __init__(self, document, act):
        self.model = BruteForce(document)
        _, rows, row_of = matrices(self.model)
        states = np.array(self.model.states)
        numbers = act(states)
        self.matrix = rows[row_of[np.arange(len(states)), numbers - 1]].tocoo()
        self.f, self.g, self.cell, self.c = states.T[[0, 2, 3, 4]]
        effects = [self.model.effect(int(number)) for number in numbers]
        self.kind = np.array([effect[0] for effect in effects])
        self.agile = np.array([effect[1] for effect in effects], bool)
        committed = np.array([effect[2] for effect in effects]) > 0
        before, after = self.matrix.row, self.matrix.col
        # Who commits stays committed, but where the goal is completed.
        self.completes = committed[before] & (self.c[after] == 0)
        self.withdraws = (self.g[before] > 0) & (self.g[after] == 0) & ~self.completes
        site = self.cell == document['grid']['service']
        self.recharges, self.repairs = ((self.kind == k) & site for k in ('recharge', 'repair'))
        parked = (self.kind == 'none') & ~self.agile & (self.cell == document['grid']['base'])
        self.flies = ~(self.recharges | self.repairs | parked)

    def start(self):
        now = np.zeros(len(self.model.states))
        now[self.model.states.index(START)] = 1.0
        return now

    def step(self, now, taken=None):
        """Masses after an epoch of the transitions that are not taken, and what was taken."""
        flow = now[self.matrix.row] * self.matrix.data
        taken = np.zeros(len(flow), bool) if taken is None else taken
        kept = np.bincount(self.matrix.col[~taken], flow[~taken], len(now))
        return kept, flow[taken].sum()

    def absorbed(self, taken):
        """Probability, after each epoch, that one of the transitions was taken."""
        now, done = self.start(), [0.0]
        for _ in range(EPOCHS):
            now, gone = self.step(now, taken)
            done.append(done[-1] + gone)
        return np.array(done)

    def withdrawn_first(self):
        now, total = self.start(), 0.0
        for _ in range(EPOCHS):
            flow = now[self.matrix.row] * self.matrix.data
            total += flow[self.withdraws].sum()
            now, _ = self.step(now, self.withdraws | self.completes)
        return total

    def expected(self, where):
        """Mean number of epochs in states."""
        now, total = self.start(), 0.0
        for _ in range(EPOCHS):
            total += now[where].sum()
            now, _ = self.step(now)
        return total

    def met(self, faults):
        """Probability that one of the fault modes is met."""
        return self.absorbed(np.isin(self.f, faults)[self.matrix.col])[-1]

    def flown_longer(self, most):
        """Probability that more than so many epochs are flown from one recharge to the next."""
        table = np.zeros((len(self.model.states), most + 1))  # By epochs since the last one.
        table[:, 0], gone, move = self.start(), 0.0, self.matrix.T.tocsr()
        flies, recharges = self.flies[:, None], self.recharges[:, None]
        for _ in range(EPOCHS):
            gone += table[self.flies, most].sum()
            after = move @ np.where(flies | recharges, 0.0, table)
            after[:, 0] += move @ np.where(recharges, table, 0.0).sum(axis=1)
            after[:, 1:] += move @ np.where(flies, table, 0.0)[:, :-1]
            table = after
        return gone


@pytest.fixture(scope='module')
def chain():
    """Policy, flights, what a forecast should say, and the median."""
    document = one_goal()
    policy = build_policy(mission_from_dict(document, 'test'), 'exact')
    rows = np.tile(START, (30_000, 1))
    flown = fly(policy.mission, policy.act, rows, EPOCHS, np.random.default_rng(5))
    return policy, flown, *exact_answers(Chain(document, policy.act))


def exact_answers(chain):
    """Everything that a forecast says, and the median, from the enumerated chain."""
    done = chain.absorbed(chain.completes)
    exact = {
        'done in 5': done[30],
        'done in 10': done[60],
        'done in 30': done[180],
        'minutes': (1 - done[:-1]).sum() / 6,
        'withdrawn': chain.withdrawn_first(),
        'recharges': chain.expected(chain.recharges),
        'repairs': chain.expected(chain.repairs),
        'agile_minutes': chain.expected(chain.agile) / 6,
        'air_minutes': chain.expected(chain.flies) / 6,
        'energy_wh': chain.expected(chain.flies) * 0.01,
        'actuator_failed': chain.met([3, 4, 7, 8]),
        'no_goal_possible': chain.met([5, 6, 7, 8]),
        'full_charge_drawn': chain.flown_longer(FULL),
    }
    return exact, np.argmax(done >= 0.5) / 6


def answers(found):
    [goal] = found.goals
    limits = {f'done in {limit}': interval for limit, interval in goal.done_within.items()}
    own = {'minutes': goal.minutes, 'withdrawn': goal.withdrawn}
    return limits | own | found.means | found.events


def blocks(flown, size):
    """Forecasts of the flights, so many at a time."""
    arrays = ('done', 'withdrawn', 'regime_epochs', 'fault_modes', 'longest_flight', 'costs')
    for first in range(0, len(flown.costs), size):
        cut = slice(first, first + size)
        yield forecast(replace(flown, **{name: getattr(flown, name)[cut] for name in arrays}))


def test_the_chain_is_one_in_which_everything_happens(chain):
    exact = dict(chain[2])
    for name in ('recharges', 'repairs', 'minutes', 'agile_minutes', 'air_minutes'):
        assert exact.pop(name) > 0.5, name
    assert exact.pop('energy_wh') > 0.1
    assert [name for name, value in exact.items() if not 0.01 < value < 0.999] == []


def test_forecast_agrees_with_the_chain(chain):
    _, flown, exact, median = chain
    found = forecast(flown)
    assert answers(found).keys() == exact.keys()
    for name, interval in answers(found).items():
        reach = max(interval.high - interval.value, interval.value - interval.low)
        assert abs(interval.value - exact[name]) < 2 * reach, name  # Four standard errors.
        assert reach < 0.03 * max(exact[name], 0.3), name
    minutes = found.goals[0].median_minutes
    assert minutes.low - ROUNDING <= median <= minutes.high + ROUNDING
    assert minutes.high - minutes.low < 0.5


def test_intervals_cover_as_often_as_they_say(chain):
    _, flown, exact, median = chain
    many = list(blocks(flown, 100))
    least = 0.95 - 4 * np.sqrt(0.95 * 0.05 / len(many))
    every = [answers(found) for found in many]
    for name, value in exact.items():
        assert np.mean([f[name].low <= value <= f[name].high for f in every]) > least, name
    minutes = [found.goals[0].median_minutes for found in many]
    covered = [m.low - ROUNDING <= median <= m.high + ROUNDING for m in minutes]
    assert np.mean(covered) > least


def test_without_chance_it_is_told_to_the_epoch():
    """Two steps to cell 5 and one epoch on it, two steps back: 10 s each, at 250 W."""
    document = case_study(1, priority_transition=np.eye(3).tolist())
    document['faults']['rate'] = dict.fromkeys(PARTS, 0.0)
    document['range']['loss'] = {'normal': 0.0, 'agile': 0.0}
    document['threat'] |= {'onset': 0.0, 'zones': {}}
    policy = build_policy(mission_from_dict(document, 'test'), 'exact')
    rows = np.tile(START, (10, 1))
    found = forecast(fly(policy.mission, policy.act, rows, EPOCHS, np.random.default_rng(0)))
    [goal] = found.goals
    for interval, value in (
        (goal.minutes, 0.5),
        (goal.median_minutes, 0.5),
        (found.means['air_minutes'], 5 / 6),
        (found.means['energy_wh'], 50 * 250 / 3600),
        (found.means['recharges'], 0),
        (found.means['agile_minutes'], 0),
    ):
        assert (interval.low, interval.value, interval.high) == pytest.approx([value] * 3)
    assert goal.done_within[5].value == 1
    assert goal.withdrawn.value == found.events['full_charge_drawn'].value == 0


def test_a_policy_does_not_differ_from_itself(chain):
    _, flown, *_ = chain
    found = difference(flown, flown)
    for interval in (*answers(found).values(), found.cost):
        assert interval.value == 0
        assert interval.low <= 0 <= interval.high


def test_differences_are_of_flights_with_the_same_luck():
    """Those of costs hold the exact one, and are closer than of flights with luck of their own."""
    mission = mission_from_dict(lively(), 'test')
    start = starts_at_base(mission, 1, np.random.default_rng(3))
    policies = [build_policy(mission, method) for method in ('exact', 'highest_priority')]
    first, second, other = (
        fly(mission, policy.act, np.repeat(start, 4000, axis=0), EPOCHS, np.random.default_rng(n))
        for policy, n in zip((*policies, policies[1]), (1, 1, 2))
    )
    exact = exact_cost(policies[1], start) - exact_cost(policies[0], start)
    paired, unpaired = difference(first, second).cost, difference(first, other).cost
    assert paired.low <= exact <= paired.high
    assert exact > 0
    assert paired.high - paired.low < 0.9 * (unpaired.high - unpaired.low)


def test_costs_cut_short_have_wider_intervals(monkeypatch):
    mission = mission_from_dict(lively(discount=0.99), 'test')
    policy = build_policy(mission, 'exact')
    start = starts_at_base(mission, 1, np.random.default_rng(3))
    monkeypatch.setattr(flights, 'MOST_EPOCHS', 100)
    flown = fly(mission, policy.act, np.repeat(start, 100, 0), 50, np.random.default_rng(0))
    value, cost = exact_cost(policy, start), _cost_of(flown)
    assert flown.cost_left > 0.3 * value
    assert cost.value < cost.value + flown.cost_left < cost.high
    assert cost.low <= value <= cost.high


def test_epochs_of_a_time(chain):
    mission = chain[0].mission
    assert [epochs_within(mission, minutes) for minutes in (0.5, 1 / 3, 0.3, 5)] == [3, 2, 1, 30]
    assert forecast_epochs(mission) == EPOCHS
    for speed, says in ((1e6, '36000000 epochs'), (0.02, '0 epochs')):
        energy = replace(mission.energy, speed=speed)
        with pytest.raises(ValueError, match=says):
            forecast_epochs(replace(mission, energy=energy))
    with pytest.raises(ValueError, match='energy: is missing'):
        forecast_epochs(replace(mission, energy=None))
