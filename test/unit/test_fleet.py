"""Fleets: local policies, queues, assignment, replanning and simulation."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
from brute_force import BruteForce, solve
from chance import DRAWS, assert_drawn_from
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, lively, missions, pick_states
from test_recombination import GoalSubMdp, optimum, recombination, seen_by

from uav_mission_manager.mdp import StateError, StateSpace, mission_from_dict
from uav_mission_manager.solver.evaluation.fleet_simulation import (
    FleetSimulator,
    Losses,
    simulate_fleets,
)
from uav_mission_manager.solver.exact import value_iteration
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.recombination import (
    FleetPlanner,
    FleetRules,
    PriorityScore,
    PriorityWeights,
    fleet,
)
from uav_mission_manager.solver.recombination.assignment import matching

CASE_STUDY = mission_from_dict(case_study(), 'test')
LITERAL = FleetRules(threshold=math.inf)
"""Nothing is ever complete: all agents join all queues, as in the paper's loops."""


def pick_fleets(mission, fleets, agents, seed=0):
    """Random states (fleets, agents, 2k+5), the priorities shared."""
    k, shape = mission.k, StateSpace(mission.k, mission.grid.q).shape
    states = np.random.default_rng(seed).integers(0, shape, size=(fleets, agents, len(shape)))
    states[..., 0] += 1
    states[..., 1 + k : 1 + 2 * k] = states[:, :1, 1 + k : 1 + 2 * k]
    return states


def at_base(agents, priorities):
    """One fleet of the case study at its base, nominal and charged."""
    return np.array([[[1, 1, 1, 1, *priorities, 0, 0, 0, 0]] * agents])


def planner(mission=CASE_STUDY, rules=None, agents=2):
    return FleetPlanner(mission, pick_fleets(mission, 1, agents)[0], rules)


# Local policies


class IdleSubMdp(GoalSubMdp):
    """The sub-MDP of a goal without its commit actions."""

    def allowed(self, state, action):
        return self.effect(action)[0] != 'commit' and super().allowed(state, action)


@cache
def reference(model, feasibility, j):
    """Solution of a sub-MDP of the case study, goals from 1."""
    return solve(model(case_study(feasibility=feasibility), j))


def test_gains_and_returns_of_local_policies():
    found = planner()
    states = pick_states(StateSpace(3, 8), 500)
    for j, policy in enumerate(found.policies, 1):
        pursuing, idle = (reference(model, 'strict', j) for model in (GoalSubMdp, IdleSubMdp))
        gain, at = idle.v - pursuing.v, seen_by(states, 3, j)
        np.testing.assert_allclose(policy.gains(states), gain[at], atol=1e-6)
        g, c, m = pursuing.states[:, 2], pursuing.states[:, 4], pursuing.states[:, 6]
        best = [gain[g == level].max() for level in range(3)]
        np.testing.assert_allclose(policy.best_gain, best, atol=1e-6)
        expected = -pursuing.v[(c == 0) & (m == 0)].mean()
        assert policy.expected_return == pytest.approx(expected, abs=1e-6)


def test_order_is_that_of_the_scores_at_hand():
    agents = at_base(2, [1, 2, 2])[0]  # eta g: 10, 16, 12.
    assert FleetPlanner(CASE_STUDY, agents).order == ('goal2', 'goal3', 'goal1')


def test_forty_goals():
    goals = [
        dataclasses.replace(goal, name=f'{goal.name}_{i}')
        for i in range(14)
        for goal in CASE_STUDY.goals
    ][:40]
    mission = dataclasses.replace(CASE_STUDY, goals=tuple(goals))
    plan = planner(mission, agents=8).plan(pick_fleets(mission, 2, 8))
    assert plan.scores.shape == (2, 40)


# The paper's queue


def test_a_goal_scores_as_with_the_agent_that_suits_it_best():
    states = pick_fleets(CASE_STUDY, 200, 3)
    plan = planner(rules=FleetRules(PriorityWeights(1, 1, 1, 1))).plan(states)
    alone = PriorityScore(CASE_STUDY, PriorityWeights(1, 1, 1, 1))
    expected = np.max([alone.of_goals(states[:, agent]) for agent in range(3)], axis=0)
    assert np.array_equal(plan.scores, expected)
    assert (np.diff(np.take_along_axis(plan.scores, plan.ranking, axis=1)) <= 0).all()


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_one_uav_in_all_queues_follows_the_rule_highest_priority(feasibility):
    mission = mission_from_dict(case_study(feasibility=feasibility), 'test')
    states = pick_fleets(mission, 5000, 1)
    plan = planner(mission, LITERAL).plan(states)
    expected = choose(recombination(mission, 'highest_priority')(states[:, 0]))
    assert np.array_equal(plan.actions[:, 0], expected)


def test_in_the_loops_as_printed_all_follow_the_first_of_the_list():
    plan = planner(rules=LITERAL).plan(pick_fleets(CASE_STUDY, 50, 4))
    assert (plan.queues >= 0).all()
    assert (plan.pursued == plan.ranking[:, :1]).all()
    assert not plan.complete.any()


def expected_rewards(document, fleet_):
    """E_j before agents are sent: 1 for a goal that is achieved."""
    model = BruteForce(document)
    return [float(g == 0) for g in model.split(fleet_[0])[2]]


def plain_queue(document, found, fleet_, ranking, holders):
    """The pseudocode for one fleet in plain loops: queues, E, C and the goal of each agent."""
    rules, names = found.rules, [goal['name'] for goal in document['goals']]
    rewards = expected_rewards(document, fleet_)
    least = [rules.thresholds.get(name, rules.threshold) for name in names]
    complete = [e >= threshold for e, threshold in zip(rewards, least)]
    ready = [
        all(complete[names.index(i)] for i in rules.preconditions.get(name, ())) for name in names
    ]
    gains = [
        [
            float(p.gains(np.array([agent]))[0]) / p.best_gain[agent[1 + len(names) + j]]
            for agent in fleet_
        ]
        for j, p in enumerate(found.policies)
    ]
    queues, pursued = [[] for _ in names], [-1] * len(fleet_)
    free = list(range(len(fleet_)))
    while free:
        open_ = [
            j
            for j in ranking
            if ready[j]
            and not complete[j]
            and rules.agents.get(names[j], 1) - pursued.count(j) <= len(free)
        ]
        if not open_:
            break
        first, cols = open_[0], document['grid']['cols']

        def nearness(k, cell=document['goals'][first]['cell'], first=first, cols=cols):
            at = fleet_[k][-4]
            away = math.hypot(at // cols - cell // cols, at % cols - cell % cols)
            return holders[k] != first, away, k

        agent = min(free, key=nearness)
        free.remove(agent)
        for j in open_:
            queues[j].append(agent)
        pursued[agent] = first
        rewards[first] += gains[first][agent]
        manned = pursued.count(first) >= rules.agents.get(names[first], 1)
        complete[first] = manned and rewards[first] >= least[first]
    return queues, rewards, complete, pursued


RULES = [
    FleetRules(),
    FleetRules(threshold=0.9, agents={'goal1': 2}),
    FleetRules(thresholds={'goal1': 0.2, 'goal2': 1.5}, agents={'goal2': 3, 'goal3': 2}),
    FleetRules(PriorityWeights(1, 2, 1, 1), {'goal3': ['goal1'], 'goal1': ['goal2']}),
    FleetRules(preconditions={'goal1': ['goal2', 'goal3']}, thresholds={'goal2': 0.3}),
]


@pytest.mark.parametrize('rules', RULES)
@pytest.mark.parametrize('agents', [1, 2, 5])
def test_queues_are_those_of_plain_loops(rules, agents):
    found, fleets = planner(rules=rules), pick_fleets(CASE_STUDY, 60, agents)
    first = found.plan(fleets)
    moved = pick_fleets(CASE_STUDY, 60, agents, seed=1)
    for states, previous in ((fleets, None), (moved, first)):
        plan = found.plan(states, None if previous is None else previous.pursued)
        for i, fleet_ in enumerate(states.tolist()):
            holders = [-2] * agents if previous is None else previous.pursued[i].tolist()
            queues, rewards, complete, pursued = plain_queue(
                case_study(), found, [tuple(s) for s in fleet_], plan.ranking[i], holders
            )
            for j, queue in enumerate(queues):
                members = np.flatnonzero(plan.queues[i, j] >= 0)
                assert members[plan.queues[i, j, members].argsort()].tolist() == queue
            np.testing.assert_allclose(plan.rewards[i], rewards, atol=1e-9)
            assert plan.complete[i].tolist() == complete
            assert plan.pursued[i].tolist() == pursued


@pytest.mark.parametrize('rules', RULES)
@pytest.mark.parametrize('assignment', ['queue', 'optimal'])
def test_what_every_plan_keeps_to(rules, assignment):
    found, states = planner(rules=rules), pick_fleets(CASE_STUDY, 300, 4)
    plan = found.plan(states, assignment=assignment)
    limits = rules.limits([goal.name for goal in CASE_STUDY.goals])
    acting = (plan.pursued[:, None] == np.arange(3)[:, None]).sum(axis=2)
    assert ((acting == 0) | (acting >= limits.counts)).all()  # Not fewer than asked for.
    before = np.array(
        [expected_rewards(case_study(), [tuple(s) for s in fleet_]) for fleet_ in states.tolist()]
    )
    done = before >= limits.thresholds
    assert not acting[done].any()
    waiting = (limits.before & ~done[:, None]).any(axis=2)
    assert not acting[waiting].any()
    assert not plan.complete[waiting & ~done].any()
    for row, ranking in enumerate(plan.ranking):
        for agent, goal in enumerate(plan.pursued[row]):
            joined = [j for j in ranking if plan.queues[row, j, agent] >= 0]
            assert goal == (joined[0] if joined else -1)  # The meta-policy.
    # Nobody stands by while a goal is open to who is left.
    left = (plan.pursued < 0).sum(axis=1)[:, None]
    assert (plan.complete | waiting | (np.maximum(limits.counts - acting, 1) > left)).all()


@pytest.mark.parametrize('assignment', ['queue', 'optimal'])
@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_joint_policy(assignment, feasibility):
    """Actions are those of the sub-MDP pursued, as far as allowed; who stands by commits not."""
    document = case_study(feasibility=feasibility)
    mission, model = mission_from_dict(document, 'test'), BruteForce(document)
    found, states = planner(mission), pick_fleets(mission, 200, 5)
    plan = found.plan(states, assignment=assignment)
    goals = np.where(plan.pursued < 0, plan.ranking[:, :1], plan.pursued)
    q = np.stack(
        [
            reference(GoalSubMdp, feasibility, j).q[seen_by(states.reshape(-1, 11), 3, j)]
            for j in (1, 2, 3)
        ],
        axis=1,
    ).reshape(200, 5, 3, 6)
    for fleet_, agent in itertools.product(range(200), range(5)):
        j, state = goals[fleet_, agent] + 1, tuple(states[fleet_, agent].tolist())
        numbers = [1, 1 + j, 5, 5 + j, 9, 10]
        values = [
            value
            for number, value in zip(numbers, q[fleet_, agent, j - 1])
            if model.allowed(state, number)
            and (plan.pursued[fleet_, agent] >= 0 or number not in (1 + j, 5 + j))
        ]
        action = plan.actions[fleet_, agent]
        assert model.allowed(state, action)
        assert q[fleet_, agent, j - 1, numbers.index(action)] == pytest.approx(
            min(values), abs=1e-5
        )
    assert (plan.pursued < 0).any()


def test_an_achieved_goal_opens_those_after_it():
    rules = FleetRules(preconditions={'goal1': ['goal2']})
    found = planner(rules=rules)
    waiting, begun = (found.plan(at_base(2, priorities)) for priorities in ([2, 1, 1], [2, 0, 1]))
    assert sorted(waiting.pursued[0]) == [1, 2]
    assert sorted(begun.pursued[0]) == [0, 2]


def test_too_few_agents_leave_a_goal_to_itself():
    found = planner(rules=FleetRules(agents={'goal1': 2}))
    for assignment in ('queue', 'optimal'):
        alone = found.plan(at_base(1, [2, 1, 0]), assignment=assignment)
        assert alone.pursued.tolist() == [[1]]
        both = found.plan(at_base(3, [2, 1, 0]), assignment=assignment)
        assert sorted(both.pursued[0]) == [0, 0, 1]


@pytest.mark.parametrize(
    ('rules', 'message'),
    [
        (
            {'preconditions': {'goal1': ['goal2'], 'goal2': ['goal3'], 'goal3': ['goal1']}},
            r'preconditions: a cycle: goal\d before goal\d before goal\d before goal\d',
        ),
        ({'preconditions': {'goal2': ['goal2']}}, 'a cycle: goal2 before goal2'),
        (
            {'preconditions': {'goal2': ['goal9']}},
            "preconditions: 'goal9' is no goal of goal1, goal2",
        ),
        ({'preconditions': {'goal0': ['goal1']}}, "preconditions: 'goal0' is no goal"),
        ({'agents': {'x': 1}}, "agents: 'x' is no goal"),
        ({'agents': {'goal1': 0}}, 'agents: goal1: 0 is not'),
        ({'agents': {'goal1': 1.5}}, 'agents: goal1: 1.5 is not'),
        ({'thresholds': {'y': 1.0}}, "thresholds: 'y' is no goal"),
        ({'thresholds': {'goal1': 0.0}}, r'thresholds: 0\.0 is not above 0'),
        ({'threshold': math.nan}, 'thresholds: nan is not above 0'),
        ({'persistence': -0.1}, 'persistence: -0.1 is not'),
        ({'persistence': math.inf}, 'persistence: inf is not'),
    ],
)
def test_rules_that_cannot_be(rules, message):
    with pytest.raises(ValueError, match=message):
        planner(rules=FleetRules(**rules))


def test_fleets_that_cannot_be():
    found, fleets = planner(), pick_fleets(CASE_STUDY, 3, 2)
    for shape in (fleets[0], fleets[:, :0]):
        with pytest.raises(ValueError, match='fleets have shape'):
            found.plan(shape)
    for wrong, message in ((fleets[..., 1:], '11 variables'), (fleets + 5, 'f = ')):
        with pytest.raises(StateError, match=message):
            found.plan(wrong)
    differ = at_base(2, [2, 1, 1])
    differ[0, 1, 4] = 0
    with pytest.raises(ValueError, match=r'fleet 0 differ .*\[\[2, 1, 1\], \[0, 1, 1\]\]'):
        found.plan(differ)
    with pytest.raises(ValueError, match=r"assignment 'best' is none of queue, optimal"):
        found.plan(fleets, assignment='best')
    with pytest.raises(ValueError, match=r'shape \(2, 2\), not \(3, 2\)'):
        found.plan(fleets, found.plan(fleets[:2]).pursued)


# Optimal assignment


@settings(max_examples=60)
@given(st.integers(1, 4), st.integers(1, 4), st.data())
def test_matching_is_the_best_of_all(agents, goals, data):
    gains = np.array(
        data.draw(
            st.lists(
                st.lists(st.integers(0, 9), min_size=goals, max_size=goals),
                min_size=agents,
                max_size=agents,
            )
        ),
        float,
    )
    need = np.array(data.draw(st.lists(st.integers(1, agents), min_size=goals, max_size=goals)))
    pairs = st.tuples(st.integers(0, agents - 1), st.integers(0, goals - 1))
    barred = np.zeros(gains.shape, bool)
    barred[tuple(zip(*data.draw(st.sets(pairs, min_size=1))))] = data.draw(st.booleans())
    matched = matching(gains, np.arange(goals), need, barred)

    def worth(choice):
        """What a choice gains; None where a goal gets too few, too many or who is barred."""
        if any(j >= 0 and barred[k, j] for k, j in enumerate(choice)):
            return None
        filled = Counter(j for j in choice if j >= 0)
        if any(count != need[j] for j, count in filled.items()):
            return None
        return sum(gains[k, j] / need[j] for k, j in enumerate(choice) if j >= 0)

    assert (matched >= 0).any() or barred.any()
    values = map(worth, itertools.product(range(-1, goals), repeat=agents))
    assert worth(matched) == pytest.approx(max(v for v in values if v is not None))


@pytest.mark.parametrize(
    ('gains', 'need', 'expected'),
    [
        ([[6, 4], [6, 4]], [2, 1], [0, 0]),  # Half of goal 0 and all of goal 1 would be 7.
        ([[6, 9], [6, 1]], [2, 1], [1, -1]),
        ([[4, 0], [4, 0], [0, 4], [0, 4]], [2, 2], [0, 0, 1, 1]),
        ([[0], [0]], [2], [0, 0]),
    ],
)
def test_teams_come_whole_or_not_at_all(gains, need, expected):
    goals = np.arange(len(need))
    assert matching(np.array(gains, float), goals, np.array(need)).tolist() == expected


def test_an_optimal_assignment_gains_no_less_than_the_queue():
    """Where one agent a goal is enough, however little it brings."""
    found, states = planner(rules=FleetRules(threshold=1e-9)), pick_fleets(CASE_STUDY, 500, 2)
    gains = np.stack(
        [policy.gains(states.reshape(-1, 11)) for policy in found.policies], axis=1
    ).reshape(500, 2, 3)
    sums = []
    for assignment in ('queue', 'optimal'):
        goals = found.plan(states, assignment=assignment).pursued[..., None]
        gained = np.take_along_axis(gains, np.maximum(goals, 0), axis=2) * (goals >= 0)
        sums.append(gained.sum(axis=(1, 2)))
    assert (sums[1] >= sums[0] - 1e-9).all()
    assert (sums[1] > sums[0] + 1).mean() > 0.1


@pytest.mark.parametrize(('persistence', 'kept'), [(0.0, False), (0.1, True)])
def test_agents_do_not_trade_goals_for_nothing(persistence, kept):
    """Two agents in one state may each pursue either goal: they go on as they began."""
    found, states = planner(rules=FleetRules(persistence=persistence)), at_base(2, [2, 1, 0])
    first = found.plan(states, assignment='optimal')
    assert sorted(first.pursued[0]) == [0, 1]
    swapped = first.pursued[:, ::-1]
    again = found.plan(states, swapped, 'optimal')
    assert np.array_equal(again.pursued, swapped) == kept


# Replanning


@pytest.fixture
def solves(monkeypatch):
    """Goals of the sub-MDPs that are solved from here on."""
    goals = []

    def counted(sub):
        goals.append(sub.goals)
        return value_iteration(sub)

    monkeypatch.setattr(fleet, 'value_iteration', counted)
    return goals


def changed_goal(mission, j, **changes):
    goals = list(mission.goals)
    goals[j] = dataclasses.replace(goals[j], **changes)
    return dataclasses.replace(mission, goals=tuple(goals))


STANDING = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ONE_GOAL = [{'eta': 3.0}, {'delta': 9.0}, {'cell': 4}, {'priority_transition': STANDING}]
NO_GOAL = [
    {'name': 'other'},
    {'energy': None},
    {'grid': dataclasses.replace(CASE_STUDY.grid, cell_size=9.0, origin=None)},
    {'grid': dataclasses.replace(CASE_STUDY.grid, elevation=((2, 12.0),))},
]
ALL_GOALS = [
    {'discount': 0.9},
    {'distance_weight': 2.0},
    {'feasibility': 'paper'},
    {'grid': dataclasses.replace(CASE_STUDY.grid, service=2)},
    {'faults': dataclasses.replace(CASE_STUDY.faults, repair_success=0.5)},
    {'range': dataclasses.replace(CASE_STUDY.range, cost=6.0)},
    {'threat': dataclasses.replace(CASE_STUDY.threat, onset=0.1)},
    {'service_cost': dataclasses.replace(CASE_STUDY.service_cost, repair=1.0)},
    {'goals': CASE_STUDY.goals[:2]},
]


def test_changed_faults_and_priorities_solve_nothing(solves):
    found = planner()
    assert Counter(solves) == {(0,): 2, (1,): 2, (2,): 2}
    states = pick_fleets(CASE_STUDY, 20, 3)
    changed = states.copy()
    changed[..., 0], changed[..., 4:7] = 2, 2 - states[..., 4:7]
    plans = [found.plan(s) for s in (states, changed)]
    again = found.replan(CASE_STUDY, changed[0])
    assert len(solves) == 6
    assert again.solved == ()
    assert not np.array_equal(plans[0].pursued, plans[1].pursued)


@pytest.mark.parametrize('changes', ONE_GOAL)
@pytest.mark.parametrize('goal', [0, 2])
def test_changed_numbers_of_a_goal_solve_its_sub_mdp_alone(solves, goal, changes):
    found = planner()
    solves.clear()
    agents = pick_fleets(CASE_STUDY, 1, 2)[0]
    again = found.replan(changed_goal(CASE_STUDY, goal, **changes), agents)
    assert again.solved == (CASE_STUDY.goals[goal].name,)
    assert Counter(solves) == {(goal,): 2}
    kept = [found.policies[j] is again.policies[j] for j in range(3)]
    assert kept == [j != goal for j in range(3)]


@pytest.mark.parametrize('changes', NO_GOAL)
def test_what_enters_no_sub_mdp_solves_nothing(solves, changes):
    found = planner()
    solves.clear()
    agents = pick_fleets(CASE_STUDY, 1, 2)[0]
    assert found.replan(dataclasses.replace(CASE_STUDY, **changes), agents).solved == ()
    assert found.replan(changed_goal(CASE_STUDY, 1, name='other'), agents).solved == ()
    assert not solves


@pytest.mark.parametrize('changes', ALL_GOALS)
def test_changed_numbers_of_all_goals_solve_all(solves, changes):
    found, mission = planner(), dataclasses.replace(CASE_STUDY, **changes)
    solves.clear()
    again = found.replan(mission, pick_fleets(mission, 1, 2)[0])
    assert sorted(again.solved) == [goal.name for goal in mission.goals]
    assert len(solves) == 2 * mission.k


def changes_of(document, other):
    """The mission with one part after the other taken from another one."""
    for part in document:
        if part in other and part not in ('goals', 'grid', 'name'):
            yield {**document, part: other[part]}
    for j, goal in enumerate(document['goals']):
        for number in ('eta', 'delta', 'cell', 'priority_transition'):
            if number in goal and number in other['goals'][j]:
                goals = [dict(entry) for entry in document['goals']]
                goals[j][number] = other['goals'][j][number]
                yield {**document, 'goals': goals}


@settings(max_examples=12)
@given(missions([(2, 2)], [2]), missions([(2, 2)], [2]), st.data())
def test_replanning_equals_planning_afresh(document, other, data):
    changed = data.draw(st.sampled_from(list(changes_of(document, other))))
    before, after = (mission_from_dict(d, 'test') for d in (document, changed))
    fleets = pick_fleets(after, 40, 3)
    replanned = planner(before).replan(after, fleets[0])
    fresh = FleetPlanner(after, fleets[0])
    assert replanned.order == fresh.order
    for assignment in ('queue', 'optimal'):
        plans = [p.plan(fleets, assignment=assignment) for p in (replanned, fresh)]
        for name, values in vars(plans[0]).items():
            np.testing.assert_array_equal(values, getattr(plans[1], name))


# Simulation


def plain_cost(document, fleet_, actions):
    """Stage cost of one fleet in plain words."""
    model, total = BruteForce(document), 0.0
    for state, action in zip(fleet_, actions):
        rest = list(state)
        rest[1 + model.k : 1 + 2 * model.k] = [0] * model.k
        total += model.cost(tuple(rest), action)
    for j, goal in enumerate(document['goals']):
        able = [state for state in fleet_ if state[1 + j] == 1]
        g = fleet_[0][1 + model.k + j]
        if not able:
            total += goal['delta'] * g
        elif all(state[-3] != j + 1 for state in able):
            total += goal['eta'] * g
    return total


@settings(max_examples=20)
@given(missions([(1, 1), (2, 3)], [1, 2]))
def test_costs_of_any_mission(document):
    """Those of fleets; of one UAV, those of the reference model."""
    mission, model = mission_from_dict(document, 'test'), BruteForce(document)
    simulator, rng = FleetSimulator(mission), np.random.default_rng(0)
    for agents in (1, 3):
        fleets = pick_fleets(mission, 40, agents)
        actions = rng.integers(1, 2 * mission.k + 5, size=(40, agents))
        costs = simulator.costs(fleets, actions)
        pairs = list(zip(fleets.tolist(), actions.tolist()))
        np.testing.assert_allclose(costs, [plain_cost(document, *p) for p in pairs], atol=1e-9)
        if agents == 1:
            expected = [model.cost(tuple(f[0]), a[0]) for f, a in pairs]
            np.testing.assert_allclose(costs, expected, atol=1e-9)


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_one_uav_moves_as_the_mission_says(feasibility):
    document = lively(feasibility=feasibility)
    model, simulator = BruteForce(document), FleetSimulator(mission_from_dict(document, 'test'))
    rng = np.random.default_rng(0)
    for number in rng.integers(len(model.states), size=25):
        state = model.states[number]
        action = rng.choice([a for a in model.actions if model.allowed(state, a)])
        expected = Counter()
        for after, p in model.successors(state, action):
            expected[tuple(map(int, after))] += p
        drawn = simulator.step(np.tile(state, (DRAWS, 1, 1)), np.full((DRAWS, 1), action), rng)
        assert_drawn_from(Counter(map(tuple, drawn[:, 0].tolist())), expected)


def test_a_goal_is_achieved_by_whoever_completes_it():
    """Two UAVs on the cell of goal 1 that commit to it, each with even chances; one elsewhere."""
    document = lively()
    simulator = FleetSimulator(mission_from_dict(document, 'test'))
    fleet_ = [
        [1, 1, 1, 2, 1, 1, 1, 0, 0],
        [2, 1, 1, 2, 1, 1, 1, 2, 1],
        [1, 1, 1, 2, 1, 0, 1, 0, 0],
    ]
    drawn = simulator.step(
        np.tile(fleet_, (DRAWS, 1, 1)), np.tile([2, 2, 2], (DRAWS, 1)), np.random.default_rng(0)
    )
    assert (drawn[..., 3:5] == drawn[:, :1, 3:5]).all()
    expected = {}
    for first, second, g in itertools.product((0, 1), (0, 1), range(3)):
        after = float(g == 0) if 0 in (first, second) else [0.2, 0.3, 0.5][g]
        expected[first, second, 1, g] = after / 4
    outcomes = np.column_stack([drawn[..., -3], drawn[:, 0, 3]])
    assert_drawn_from(Counter(map(tuple, outcomes.tolist())), expected)
    other = dict(enumerate([0.3, 0.4, 0.3]))
    assert_drawn_from(Counter(drawn[:, 0, 4].tolist()), other)


def test_the_cost_of_one_uav_with_one_goal_is_the_optimum():
    mission = mission_from_dict(case_study(1), 'test')
    start = np.repeat([[[1, 1, 2, 0, 0, 0, 0]]], 4000, axis=0)
    costs = simulate_fleets(planner(mission, LITERAL), start, 150, np.random.default_rng(0))
    least = optimum(mission)(start[:1, 0]).min()
    error = costs.std() / math.sqrt(len(costs))
    assert error < 0.01 * least
    assert abs(costs.mean() - least) < 4 * error + 0.95**150 * 20 * 50


def test_fleets_that_decide_differently_meet_with_the_same_luck():
    found, start = planner(), pick_fleets(CASE_STUDY, 20, 3)
    costs, after = [], []
    for assignment in ('queue', 'optimal', 'queue'):
        rng = np.random.default_rng(3)
        costs.append(simulate_fleets(found, start, 20, rng, assignment))
        after.append(rng.random())
    assert after[0] == after[1]
    assert np.array_equal(costs[0], costs[2])
    assert not np.array_equal(costs[0], costs[1])


class Journal:
    """Notes what a simulation asks to decide, and lets the planner do so."""

    def __init__(self, found):
        self.found, self.asked = found, []

    def __call__(self, states, pursued, kept, barred):
        self.asked.append((states.copy(), pursued, kept, barred))
        return self.found.plan(states, pursued, kept=kept, barred=barred)


def test_a_lost_uav_keeps_its_goal_until_it_is_noticed_and_never_acts():
    document = {**case_study(), 'priority_transition': [list(row) for row in STANDING]}
    mission = mission_from_dict(document, 'test')
    found = planner(mission, FleetRules(threshold=1e-9))
    fleets = np.repeat(at_base(2, [2, 1, 1]), 30, axis=0)
    losses, journal, seen = Losses(np.tile([1, 50], (30, 1)), 2), Journal(found), []
    rng = np.random.default_rng(0)
    simulate_fleets(found, fleets, 12, rng, losses=losses, decide=journal, watch=seen.append)
    assert len(seen) == 13
    first = found.plan(fleets).pursued
    assert (first == [0, 1]).all()
    for epoch, (states, pursued, kept, barred) in enumerate(journal.asked):
        lost = epoch >= 1
        assert barred[:, 0].all() == barred[:, 0].any() == lost
        assert not barred[:, 1].any()
        open_ = states[:, 0, 4] > 0
        assert (kept[:, 0] == np.where(open_ & (epoch in (1, 2)), 0, -1)).all()
        assert (kept[:, 1] == -1).all()
        if lost:  # Nominal, out of range, at the base, uncommitted, calm, normal.
            assert (states[:, 0, [0, 1, 2, 3, 7, 8, 9, 10]] == [1, 0, 0, 0, 0, 0, 0, 0]).all()
        if epoch >= 3:
            assert (pursued[:, 0] == -1).all() or epoch == 3
    # The other one does the first goal too, when it is noticed that nobody does.
    assert (seen[3][:, 0, 4] == 2).all()
    assert (seen[12][:, 0, 4] == 0).any()


def test_nobody_lost_is_as_without_losses():
    found, start = planner(), pick_fleets(CASE_STUDY, 20, 3)
    never = Losses(np.full((20, 3), 20), 1)
    plain, same = (
        simulate_fleets(found, start, 20, np.random.default_rng(3), 'optimal', losses=losses)
        for losses in (None, never)
    )
    assert np.array_equal(plain, same)
