"""What another model changes: where the policy acts otherwise, and what the old one would cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.mdp import Mission, allowed_actions
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy import build_policy
from uav_mission_manager.solver.evaluation import (
    evaluate,
    flown_states,
    representatives,
    start_state,
    tabulate,
)
from uav_mission_manager.solver.submdp import whole_mission

TOLERANCE = 1e-6
"""Largest distance of a cost from the exact one."""

COMPARED_STATES = 5_000
"""States over which it is told how much of the flying changes: a choice."""


@dataclass(frozen=True)
class PolicyEffect:
    """The optimal policies of an old and a new model, compared in the new one.

    Attributes
    ----------
    states, changed : int
        All that policies tell apart, and those in which the action is another.
    flown_changed : float
        Share of them where the old policy flies: in its discounted occupancy from base.
    old_cost, new_cost : float
        Of both policies at the start: at base, charged, all goals of high priority.
    expected : float
        What the old model had said of the old policy there.
    mean_loss, largest_loss : float
        V^old / V^new - 1 over all states.
    """

    states: int
    changed: int
    flown_changed: float
    old_cost: float
    new_cost: float
    expected: float
    mean_loss: float
    largest_loss: float


def effect(old: Mission, new: Mission) -> PolicyEffect:
    """Compare exactly.

    Where the new model does not allow what the old policy does, it does not commit, as action 1.

    Raises
    ------
    MissionSizeError
        If the memory does not suffice.
    """
    policies = [build_policy(mission, 'exact', TOLERANCE) for mission in (old, new)]
    sub, start = whole_mission(new), start_state(new)
    acts = allowed(new, policies[0].act), policies[1].act
    tables = [tabulate(sub, act) for act in acts]
    every = representatives(sub)
    values = [evaluate(sub, table, TOLERANCE).state_values(every) for table in tables]
    flown = flown_states(new, acts[0], COMPARED_STATES, np.random.default_rng(0))
    loss = _loss(*values)
    at_start = [_value_at(start, every, value) for value in values]
    return PolicyEffect(
        states=tables[0].size,
        changed=int((tables[0] != tables[1]).sum()),
        flown_changed=float((acts[0](flown) != acts[1](flown)).mean()),
        old_cost=at_start[0],
        new_cost=at_start[1],
        expected=float(policies[0].q_values(start).min()),
        mean_loss=float(loss.mean()),
        largest_loss=float(loss.max()),
    )


def allowed(
    mission: Mission, act: Callable[[IntArray], IntArray]
) -> Callable[[IntArray], IntArray]:
    """Return a policy that takes action 1 where a mission does not allow what it would do."""

    def acts(states: IntArray) -> IntArray:
        actions = act(states)
        may = allowed_actions(mission, states)[np.arange(len(states)), actions - 1]
        return np.where(may, actions, 1)

    return acts


def _value_at(state: IntArray, every: IntArray, values: FloatArray) -> float:
    """Return the value of a state without commitment, in normal mode."""
    return float(values[(every == state).all(axis=1)][0])


def _loss(old: FloatArray, new: FloatArray) -> FloatArray:
    """V^old / V^new - 1; 0 where there is nothing to pay."""
    return np.divide(old - new, new, out=np.zeros_like(old), where=new > 0)
