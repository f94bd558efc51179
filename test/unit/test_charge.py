"""Missions with one battery: what is solved, stored and simulated is what enumeration finds."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from brute_force import BruteForce, solve
from strategies import case_study, lively, pick_states, with_charge
from test_brute_force import assert_bellman, assert_same_q, assert_simulated

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.cli import mission_simulate, policy_query
from uav_mission_manager.cli.check.probabilities import probability_findings
from uav_mission_manager.mdp import MissionError, StateError, StateSpace, mission_from_dict
from uav_mission_manager.mdp.charge import RangeFlags, charge_level, range_table, state_flags
from uav_mission_manager.solver.decomposition.decompose import decompose
from uav_mission_manager.solver.evaluation import (
    evaluate,
    forecast,
    sensitivity,
    simulation,
    tabulate,
)
from uav_mission_manager.solver.evaluation.fleet_simulation import FleetSimulator
from uav_mission_manager.solver.evaluation.flights import fly
from uav_mission_manager.solver.exact import AxisModel, solve_blocks, stride, value_iteration
from uav_mission_manager.solver.submdp import whole_mission


def read(document):
    return mission_from_dict(document, 'test')


def one_goal(goal=1, **changes):
    """One goal of the case study; a battery of eight levels lasts some eight epochs."""
    return with_charge(case_study(goal), **{'levels': 8} | changes)


@pytest.fixture(scope='module')
def small():
    """Two goals, with the reference's solution."""
    document = with_charge(lively(), levels=4)
    return document, read(document), solve(BruteForce(document))


# The file


def test_the_charge_takes_the_place_of_the_range_flags():
    mission = read(with_charge(case_study(), levels=16))
    space = StateSpace.of(mission)
    assert space.names == ('f', 'b', 'g1', 'g2', 'g3', 'l', 'c', 't', 'm')
    assert space.size == 8 * 16 * 27 * 8 * 4 * 3 * 2 == whole_mission(mission).states
    assert whole_mission(mission).entries == 82_944
    with pytest.raises(StateError, match=r'b = 16 is outside 0\.\.15'):
        space.check([1, 16, 0, 0, 0, 0, 0, 0, 0])


def test_a_file_says_what_its_mission_says():
    for changes in ({}, {'rate': 2}, {'noise': 0.0}):
        mission = read(with_charge(case_study(), **changes))
        assert read(json.loads(json.dumps(mission.to_dict()))) == mission
    assert mission.digest() != read(with_charge(case_study())).digest()


def test_defaults():
    document = with_charge(case_study())
    document['range']['charge'] = {'empty_cost': 1.0}
    charge = read(document).range.charge
    assert (charge.levels, charge.reserve, charge.rate) == (16, 0.1, None)


def test_the_drain_is_the_energy_of_an_epoch():
    """600 W for 10 s are a sixth of 10 Wh: one of six levels; 900 W for 9 s are 1.35 of them."""
    drain = read(with_charge(case_study(), noise=0.0)).range.charge.drain
    assert drain.normal == pytest.approx((0.0, 1.0))
    assert drain.agile == pytest.approx((0.0, 0.65, 0.35))
    noisy = read(with_charge(case_study(), noise=0.5)).range.charge.drain
    assert noisy.normal == pytest.approx((0.125, 0.75, 0.125))
    assert np.dot(noisy.agile, range(len(noisy.agile))) == pytest.approx(1.35)


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        (lambda d: d.pop('energy'), 'range.charge: needs the section energy, which is missing'),
        (
            lambda d: d['range'].update(loss={'normal': 0.1, 'agile': 0.1}),
            'range.charge: is given besides range.loss: keep one of them',
        ),
        (lambda d: d['range'].pop('charge'), 'range.loss: is missing'),
        (
            lambda d: d['range']['charge'].update(levels=1),
            'range.charge.levels: 1 is outside 2..1000',
        ),
        (
            lambda d: d['range']['charge'].update(rate=0),
            'range.charge.rate: 0 is outside 1..1000',
        ),
        (
            lambda d: d['range']['charge'].update(reserve=1.5),
            'range.charge.reserve: 1.5 is outside 0..1',
        ),
        (lambda d: d['range']['charge'].pop('empty_cost'), 'range.charge.empty_cost: is missing'),
        (
            lambda d: d['range']['charge'].update(drain={'normal': [0.5, 0.4], 'agile': [1.0]}),
            'range.charge.drain.normal: row [0.5, 0.4] sums to 0.9, not to 1',
        ),
        (
            lambda d: d['range']['charge'].update(drain={'normal': [], 'agile': [1.0]}),
            'range.charge.drain.normal: [] is not a list of 1 to 1000 probabilities',
        ),
        (
            lambda d: d['range']['charge'].update(
                noise=0.1, drain={'normal': [1.0], 'agile': [1.0]}
            ),
            'range.charge.drain: is given besides range.charge.noise: keep one of them',
        ),
        (
            lambda d: d['energy'].update(capacity=1e-320, voltage=1e-10),
            'range.charge.levels: a step takes 10 s, a full battery lasts 0 s',
        ),
    ],
)
def test_what_is_refused(change, says):
    document = with_charge(case_study())
    change(document)
    with pytest.raises(MissionError) as error:
        read(document)
    assert str(error.value) == f'test: {says}'


# Range flags


def test_flags_are_those_of_the_energy_model():
    document = with_charge(case_study(), levels=16)
    mission, model = read(document), BruteForce(document)
    table = range_table(mission)
    assert 0 < table.mean() < 1
    for (j, cell, level), flag in np.ndenumerate(table):
        assert flag == model.in_range(level, cell, j)


def test_levels_count_from_the_lower_end():
    assert [charge_level(4, charge) for charge in (0.0, 0.24, 0.25, 0.99, 1.0)] == [0, 0, 1, 3, 3]


# The exact solution


@pytest.mark.parametrize(
    ('goal', 'changes'),
    [(1, {}), (2, {'rate': 3}), (3, {'noise': 1.0, 'reserve': 0.3}), (1, {'empty_cost': 0.0})],
)
def test_every_q_of_one_goal(goal, changes):
    assert_same_q(one_goal(goal, **changes))


def test_every_q_where_all_is_allowed():
    assert_same_q(one_goal() | {'feasibility': 'paper'})


def test_every_q_of_two_goals(small):
    _, mission, reference = small
    q = build_policy(mission, 'exact').q_values(reference.states)
    np.testing.assert_array_equal(np.isinf(q), np.isinf(reference.q))
    allowed = np.isfinite(reference.q)
    np.testing.assert_allclose(q[allowed], reference.q[allowed], rtol=0, atol=1e-6)


def test_bellman_equation_of_three_goals():
    document = with_charge(case_study(), levels=12)
    policy = build_policy(read(document), 'exact')
    assert_bellman(document, policy, pick_states(policy.space, 60))


@pytest.mark.parametrize('kind', ['location', 'fault', 'blocks'])
def test_blocks_give_the_same(small, kind):
    _, mission, _ = small
    sub = whole_mission(mission)
    plan = decompose(mission, sub.states // 3, kind)
    assert len(plan.parts) > 1
    found, whole = solve_blocks(sub, plan.regions, 1e-8), value_iteration(sub, 1e-8)
    np.testing.assert_allclose(found.value, whole.value, rtol=0, atol=3e-8)


def test_bounds_hold_in_single_precision(small):
    _, mission, reference = small
    solution = value_iteration(whole_mission(mission), 1e-3, precision='single')
    off = reference.v - AxisModel(solution.sub).state_values(solution.value, reference.states)
    assert (off >= solution.lower).all()
    assert (off <= solution.upper).all()


def test_more_levels_and_less_noise_come_to_a_limit():
    """The cost at base, full, comes to what a grid has that halves nothing any more."""

    def cost(levels):
        document = one_goal(levels=levels, noise=0.0, reserve=0.0, empty_cost=20.0)
        policy = build_policy(read(document), 'exact')
        state = [1, levels - 1, 2, policy.mission.grid.base, 0, 0, 0]
        return float(policy.part_values([state])[0, 0])

    costs = [cost(levels) for levels in (8, 32, 128, 256)]
    errors = np.abs(np.array(costs[:-1]) - costs[-1])
    assert (errors[1:] < errors[:-1] / 2).all()
    assert errors[-1] < 0.01 * costs[-1]


# Policies, evaluation, simulation


@pytest.mark.parametrize('method', ['split', 'highest_priority', 'best_value', 'expansion'])
def test_other_policies_cost_no_less_than_the_optimum_and_no_more_than_they_say(small, method):
    _, mission, reference = small
    policy = build_policy(mission, method, certificate=method != 'split')
    sub = whole_mission(mission)
    taken = evaluate(sub, tabulate(sub, policy.act)).state_values(reference.states)
    assert (taken >= reference.v - 1e-6).all()
    assert (policy.lower_bound(reference.states) <= reference.v + 1e-6).all()
    assert (policy.lower_bound(reference.states) > 0).any()
    if method == 'expansion':
        assert policy.upper_bound_holds == 'everywhere'
        assert (taken <= policy.upper_bound(reference.states)).all()
        assert (taken <= 1.01 * reference.v).all()


@pytest.mark.parametrize('method', ['exact', 'split', 'expansion'])
def test_a_policy_set_is_the_same_when_loaded(small, method, tmp_path, capsys):
    _, mission, _ = small
    policy = build_policy(mission, method)
    policy.save(tmp_path / 'set')
    loaded, states = load_policy(tmp_path / 'set'), pick_states(policy.space, 200)
    np.testing.assert_array_equal(loaded.q_values(states), policy.q_values(states))
    np.testing.assert_array_equal(loaded.act(states), policy.act(states))
    state = [1, 3, 2, 0, 1, 0, 0, 0]
    text = ','.join(map(str, state))
    assert policy_query.main([str(tmp_path / 'set'), '--state', text, '--json']) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer['state'] == dict(zip(('f', 'b', 'g1', 'g2', 'l', 'c', 't', 'm'), state))


def test_simulated_costs_are_those_of_the_policy(small):
    _, mission, reference = small
    assert_simulated(mission, reference)


def test_a_fleet_of_one_costs_what_one_vehicle_costs(small):
    _, mission, _ = small
    policy = build_policy(mission, 'exact')
    states = pick_states(policy.space, 500)
    actions = policy.act(states)
    found = FleetSimulator(mission).costs(states[:, None], actions[:, None])
    np.testing.assert_allclose(found, simulation.Simulator(mission).costs(states, actions))


def test_recharging_says_how_much_there_is(small):
    _, mission, _ = small
    policy = build_policy(mission, 'exact')
    recharge = 2 * mission.k + 3
    states = policy.space.states()
    state = states[policy.act(states) == recharge][0].tolist()
    assert policy.decide(state).reason.startswith(f'charge {state[1]} of 3, out of range: ')


def test_flags_of_states(small):
    document, mission, _ = small
    model, states = BruteForce(document), pick_states(StateSpace.of(mission), 300)
    flags = RangeFlags(mission)(StateSpace.of(mission).split(states))
    expected = [model.split(tuple(state))[1] for state in states.tolist()]
    np.testing.assert_array_equal(flags, expected)


def test_flags_of_one_state_are_those_of_many(small):
    with_flags = read(lively())
    for mission in (small[1], with_flags):
        space = StateSpace.of(mission)
        states = pick_states(space, 50)
        for state, flags in zip(states, RangeFlags(mission)(space.split(states)).tolist()):
            assert state_flags(mission, space.split(state)) == tuple(flags)


def test_a_mission_in_python_needs_energy_for_its_charge():
    mission = copy.copy(read(with_charge(case_study())))
    with pytest.raises(ValueError, match=r'range\.charge: needs energy'):
        type(mission)(**{**vars(mission), 'energy': None})


def test_longer_strides_come_to_the_same_values_sooner(monkeypatch):
    """An empty battery stays at base for ever: plain sweeps come closer by the discount only."""
    sub = whole_mission(read(with_charge(case_study(1, 2), levels=16, empty_cost=500.0)))
    found = value_iteration(sub, 1e-8)
    monkeypatch.setattr(stride, 'PLAIN_SWEEPS', 10**9)
    plain = value_iteration(sub, 1e-8)
    assert found.iterations < 0.7 * plain.iterations
    assert max(found.upper, plain.upper) < 2e-8
    np.testing.assert_allclose(found.value, plain.value, rtol=0, atol=4e-8)


def test_strides_that_do_not_help_are_given_up(monkeypatch):
    sub = whole_mission(read(with_charge(case_study(1), levels=16, empty_cost=500.0)))
    plain = value_iteration(sub, 1e-8)
    monkeypatch.setattr(stride, 'PLAIN_SWEEPS', 1)
    found = value_iteration(sub, 1e-8)
    assert found.converged
    np.testing.assert_allclose(found.value, plain.value, rtol=0, atol=4e-8)


def test_sensitivity_is_that_of_missions_solved_anew():
    document = json.loads(json.dumps(read(one_goal(noise=0.5)).to_dict()))
    charge, start = document['range']['charge'], [1, 7, 2, 0, 0, 0, 0]

    def cost(**changes):
        changed = document | {'range': document['range'] | {'charge': charge | changes}}
        policy = build_policy(read(changed), 'exact', tolerance=1e-10)
        return float(policy.part_values([start])[0, 0])

    solution = build_policy(read(document), 'exact', tolerance=1e-10).solution
    found = {each.name: each for each in sensitivity.by_solving(solution, np.array([start]))}
    before, drain = cost(), charge['drain']
    p, rest = drain['normal'][0] * 1.1, (1 - drain['normal'][0] * 1.1)
    scaled = [p, *(q * rest / (1 - drain['normal'][0]) for q in drain['normal'][1:])]
    for name, after in (
        ('range.charge.empty_cost', cost(empty_cost=charge['empty_cost'] * 1.1)),
        ('range.charge.drain.normal.0', cost(drain=drain | {'normal': scaled})),
    ):
        assert found[name].relative == pytest.approx(after / before - 1, abs=2e-6)


def test_a_battery_that_lasts_for_ever_has_no_sensitivity_to_its_drain():
    document = one_goal()
    document['range']['charge']['drain'] = {'normal': [1.0], 'agile': [0.5, 0.5]}
    names = {parameter.name for parameter in sensitivity.parameters(read(document))}
    assert 'range.charge.drain.agile.1' in names
    assert 'range.charge.drain.normal.0' not in names


def test_policies_of_charge_and_flags_cannot_be_compared(small, tmp_path):
    document, mission, _ = small
    flagged = read(lively() | {'energy': document['energy']})
    for name, each in (('a', mission), ('b', flagged)):
        build_policy(each, 'exact').save(tmp_path / name)
    names = str(tmp_path / 'a'), '--compare', str(tmp_path / 'b')
    with pytest.raises(SystemExit, match=r'--compare: states of .* are others, f r1 r2 g1 g2'):
        mission_simulate.main([*names, '--episodes', '10'])


def test_a_forecast_counts_agile_flight_by_its_own_energy(small):
    """600 W for 10 s, 900 W for 9 s."""
    mission = small[1]
    policy = build_policy(mission, 'exact')
    start = np.repeat([[1, 3, 2, 2, 0, 0, 2, 0]], 50, axis=0)
    flights = fly(mission, policy.act, start, 40, np.random.default_rng(0))
    normal, agile = flights.regime_epochs[:, :2].T
    assert agile.any()
    found = forecast.forecast(flights).means['energy_wh'].value
    assert found == pytest.approx(((6000 * normal + 8100 * agile) / 3600).mean())


def findings_of(document):
    return {finding.field: finding.text for finding in probability_findings(read(document))}


def test_mission_check_warns_of_batteries_that_last_too_long_or_too_short():
    fields = {f'range.charge.drain.{mode} (noise)' for mode in ('normal', 'agile')}
    assert not fields & set(findings_of(with_charge(case_study(), levels=16)))
    for drain in ([1.0], [0.0] * 7 + [1.0]):
        document = with_charge(case_study(), levels=16)
        document['range']['charge']['drain'] = {'normal': drain, 'agile': drain}
        found = findings_of(document)
        assert fields <= set(found)
    assert found['range.charge.drain.normal (noise)'].startswith('an epoch of flight drains 7 of')


def test_mission_check_warns_of_goals_that_no_charge_reaches():
    document = with_charge(case_study(), levels=16, reserve=0.9)
    assert {f'goals.{j}.cell' for j in range(3)} <= set(findings_of(document))
    assert 'goals.0.cell' not in findings_of(with_charge(case_study(), levels=16))
