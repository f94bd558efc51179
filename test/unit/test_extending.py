"""A mission of the user's own making, as docs/extending.md has it, against the reference model."""

from __future__ import annotations

import re
import runpy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from brute_force import BruteForce, solve
from strategies import case_study, lively

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import THREAT_LEVELS, Mission, global_actions, mission_from_dict
from uav_mission_manager.mdp.mission import Row, Threat
from uav_mission_manager.solver.evaluation.policy_evaluation import evaluate, tabulate
from uav_mission_manager.solver.evaluation.sensitivity import parameters
from uav_mission_manager.solver.evaluation.simulation import cost_horizon, simulate
from uav_mission_manager.solver.exact import look_ahead, solve_blocks, sweep, value_iteration
from uav_mission_manager.solver.recombination.fleet import FleetPlanner
from uav_mission_manager.solver.recombination.priority import calm_flight
from uav_mission_manager.solver.submdp import whole_mission

EXTREME_COST = (9.0, 5.0)
NOISE = 1.5
"""Cost of an epoch in agile flight in cell 1, where people live."""


@dataclass(frozen=True)
class ThreatOfFourLevels(Threat):
    """A high threat may become extreme, and an extreme one lasts."""

    levels: ClassVar[tuple[str, ...]] = (*THREAT_LEVELS, 'extreme')
    rises: float = 0.25
    from_extreme: Row = (0.1, 0.0, 0.3, 0.6)

    def transition(self, onset):
        none, low, high = super().transition(onset)
        risen = (*(p * (1 - self.rises) for p in high), self.rises)
        return (*none, 0.0), (*low, 0.0), risen, self.from_extreme


def extended(document):
    """The mission of a document with a fourth threat level and a cost of noise."""
    mission = mission_from_dict(document, 'test')
    cost = (*mission.threat.cost, EXTREME_COST)
    noise = np.zeros((2 * mission.k + 4, mission.grid.q))
    noise[[action.agile for action in global_actions(mission)], 1] = NOISE
    return replace(
        mission,
        threat=ThreatOfFourLevels(**vars(mission.threat) | {'cost': cost}),
        extra_costs=tuple(map(tuple, noise.tolist())),
    )


class Reference(BruteForce):
    """The same, written out."""

    threats = 4

    def cost(self, state, action):
        *_, cell, _, t, m = state
        _, agile, *_ = self.effect(action)
        noise = NOISE if agile and cell == 1 else 0.0
        if t < 3:
            return super().cost(state, action) + noise
        calm = super().cost((*state[:-2], 0, m), action) - self.document['threat']['cost'][0][m]
        return calm + EXTREME_COST[m] + noise

    def threat_outcomes(self, t, cell):
        if t == 3:
            return [(0, 0.1), (2, 0.3), (3, 0.6)]
        outcomes = super().threat_outcomes(t, cell)
        if t < 2:
            return outcomes
        return [*((after, 0.75 * p) for after, p in outcomes), (3, 0.25)]


def one_goal():
    document = lively()
    return document | {'goals': document['goals'][:1]}


@pytest.fixture(scope='module')
def two_goals():
    """Mission of two goals in three cells, its states, Q and V; of Q see the Bellman equation."""
    policy = build_policy(extended(lively()), 'exact')
    states = policy.space.states()
    q = policy.q_values(states)
    return policy, states, q, q.min(axis=1)


def assert_same(found, reference):
    np.testing.assert_array_equal(np.isinf(found), np.isinf(reference))
    allowed = np.isfinite(reference)
    np.testing.assert_allclose(found[allowed], reference[allowed], rtol=0, atol=1e-6)


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_every_q_of_one_goal(feasibility):
    document = one_goal() | {'feasibility': feasibility}
    reference = solve(Reference(document))
    policy = build_policy(extended(document), 'exact')
    np.testing.assert_array_equal(policy.space.states(), reference.states)
    assert_same(policy.q_values(reference.states), reference.q)


def test_bellman_equation_of_two_goals(two_goals):
    policy, states, q, v = two_goals
    model = Reference(lively())
    for row in np.random.default_rng(3).choice(len(states), 40, replace=False):
        for action in model.actions:
            state = tuple(states[row].tolist())
            if not model.allowed(state, action):
                assert q[row, action - 1] == np.inf
                continue
            after, p = zip(*model.successors(state, action))
            later = model.document['discount'] * np.dot(p, v[policy.space.index(after)])
            assert q[row, action - 1] == pytest.approx(model.cost(state, action) + later, abs=1e-6)


def test_the_extension_changes_what_is_best(two_goals):
    policy, states, *_ = two_goals
    plain = build_policy(mission_from_dict(lively(), 'test'), 'exact')
    known = states[states[:, -2] < 3]
    assert (policy.act(known) != plain.act(known)).any()


def test_blocks_and_small_tables_find_the_same(two_goals, monkeypatch):
    policy, states, q, _ = two_goals
    sub = whole_mission(policy.mission)
    whole = value_iteration(sub).value
    blocks = [((0,), range(1, 9)), ((1, 2), range(1, 5)), ((1, 2), range(5, 9))]
    np.testing.assert_allclose(solve_blocks(sub, blocks, 1e-3).value, whole, rtol=0, atol=1e-3)
    for rows in (9, 3, 1):  # Of 36 that W has.
        monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', 3 * rows * 32)
        np.testing.assert_allclose(value_iteration(sub).value, whole, rtol=0, atol=1e-9)
    monkeypatch.setattr(look_ahead, 'MAX_TABLED_ENTRIES', 0)
    some = slice(None, None, 101)
    assert_same(build_policy(policy.mission, 'exact').q_values(states[some]), q[some])


@pytest.mark.parametrize('method', ['expansion', 'split', 'highest_priority', 'best_value'])
def test_approximate_methods_keep_their_promises(two_goals, method):
    exact, states, q, v = two_goals
    policy = build_policy(exact.mission, method, certificate=True)
    assert (policy.lower_bound(states) <= v + 1e-6).all()
    taken = q[np.arange(len(states)), policy.act(states) - 1]
    assert np.isfinite(taken).all()
    if method == 'expansion':
        assert policy.upper_bound_holds == 'everywhere'
        assert (taken <= policy.upper_bound(states)).all()
        assert (taken <= 1.01 * v).all()


def test_evaluation_and_simulation_find_the_optimal_cost(two_goals):
    policy, states, _, v = two_goals
    mission, sub = policy.mission, whole_mission(policy.mission)
    found = evaluate(sub, tabulate(sub, policy.act)).state_values(states)
    np.testing.assert_allclose(found, v, rtol=0, atol=1e-6)
    start = [1, 1, 1, 2, 2, 0, 0, 3, 0]
    epochs = cost_horizon(mission, 1e-6)
    samples, _ = simulate(mission, policy.act, [start] * 1000, epochs, np.random.default_rng(1))
    best = v[policy.space.index(start)[0]]
    assert samples.mean() == pytest.approx(best, abs=4 * samples.std() / 1000**0.5)


def test_priorities_and_fleets_know_four_levels(two_goals):
    policy, *_ = two_goals
    fleet = np.array([[1, 1, 1, 2, 1, cell, 0, 3, 0] for cell in (0, 2)])
    assert FleetPlanner(policy.mission, fleet).plan(fleet[None]).actions.shape == (1, 2)
    threat = policy.mission.threat
    calm = [1 - threat.onset * threat.high_share, 0.5 + 0.3, (0.2 + 0.3) * 0.75, 0.1]
    np.testing.assert_allclose(calm_flight(policy.mission, 1)[0], calm, rtol=1e-12)


def test_the_reason_names_the_level(two_goals):
    policy, states, *_ = two_goals
    agile = states[(states[:, -2] == 3) & (policy.act(states) == 4)][0]
    assert policy.decide(agile.tolist()).reason.startswith('no goal is wanted, threat extreme;')


def test_what_no_mission_file_says_is_not_saved(two_goals, tmp_path):
    with pytest.raises(ValueError, match='extra_costs: no mission file has them'):
        two_goals[0].save(tmp_path / 'set')
    assert not list(tmp_path.iterdir())


def test_the_document_of_a_mission_says_all_of_it_or_nothing(two_goals):
    mission = replace(two_goals[0].mission, extra_costs=())
    for use in (Mission.digest, parameters):
        with pytest.raises(ValueError, match='threat: no mission file has a ThreatOfFourLevels'):
            use(mission)


def test_the_documentation_runs_as_it_stands(monkeypatch, tmp_path):
    monkeypatch.chdir(Path(__file__).parents[2])
    text = Path('docs/extending.md').read_text(encoding='utf-8')
    example = tmp_path / 'example.py'
    example.write_text('\n'.join(re.findall(r'^```python\n(.*?)^```', text, re.M | re.S)))
    found = runpy.run_path(str(example))
    policy, noise = found['policy'], found['noise']
    assert f'{policy.space.size:,}' in text
    assert policy.mission.threat.levels[3] == 'extreme'
    assert np.argwhere(noise == NOISE).tolist() == [[action, 1] for action in (4, 5, 6, 7)]


def test_levels_need_a_cost_each():
    threat = mission_from_dict(case_study(), 'test').threat
    with pytest.raises(ValueError, match=r'threat\.cost: 3 rows are not one each of none, low'):
        ThreatOfFourLevels(**vars(threat))


@pytest.mark.parametrize(
    ('how', 'problem'),
    [
        ({'rises': 1.5}, r'\(.*, 1\.5\) are no probabilities of sum 1'),
        ({'from_extreme': (0.1, 0.0, 0.3, 0.5)}, r'.* are no probabilities of sum 1'),
        ({'from_extreme': (0.1, 0.0, 0.9)}, 'not 4 rows of 4 numbers'),
    ],
)
def test_chains_that_make_no_sense(two_goals, how, problem):
    with pytest.raises(ValueError, match=rf'threat\.transition: {problem}'):
        replace(two_goals[0].mission.threat, **how)


@pytest.mark.parametrize(
    ('costs', 'problem'),
    [
        (((1.0,) * 8,), 'not 10 rows of 8'),
        (((1.0,) * 7,) * 10, 'not 10 rows of 8'),
        (((-1.0, *(1.0,) * 7),) * 10, '-1.0 is below 0 or not finite'),
        (((float('nan'), *(1.0,) * 7),) * 10, 'nan is below 0 or not finite'),
    ],
)
def test_extra_costs_that_make_no_sense(costs, problem):
    with pytest.raises(ValueError, match=f'extra_costs: {problem}'):
        replace(mission_from_dict(case_study(), 'test'), extra_costs=costs)
