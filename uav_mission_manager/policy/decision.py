"""One decision: the action of least expected cost, and why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from uav_mission_manager.mdp import (
    FAULT_MODES,
    PRIORITY_LEVELS,
    Action,
    ActionKind,
    Mission,
    StateSpace,
    action_name,
)
from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.charge import state_flags


@dataclass(frozen=True)
class Decision:
    """What to do in a state.

    Attributes
    ----------
    state : tuple of int
        [f r.. g.. l c t m].
    action, runner_up : Action, Action or None
        The choice, and the best of the rest; None where nothing else is allowed.
    values : tuple of float
        Q of each of the 2k+4 actions; inf where not allowed.
    margin : float
        Q of the runner-up less Q of the choice; inf without a runner-up, not below 0.
    reason : str
        One line for people.
    bounds : callable
        Returns arrays (1,) of both bounds: a command need not wait for them.
    """

    state: tuple[int, ...]
    action: Action
    runner_up: Action | None
    values: tuple[float, ...]
    margin: float
    reason: str
    bounds: Callable[[], tuple[FloatArray, FloatArray]] = field(repr=False, compare=False)

    @cached_property
    def _bounds(self) -> tuple[float, ...]:
        return tuple(float(bound[0]) for bound in self.bounds())

    @property
    def lower_bound(self) -> float:
        """Guaranteed lower bound on the optimal cost V*(s)."""
        return self._bounds[0]

    @property
    def upper_bound(self) -> float:
        """Upper bound on the cost V^pi(s) of the policy; inf where none is known."""
        return self._bounds[1]


def explain(
    mission: Mission,
    actions: Sequence[Action],
    state: list[int],
    number: int,
    values: FloatArray,
    bounds: Callable[[], tuple[FloatArray, FloatArray]],
) -> Decision:
    """Say why an action is chosen, by the Q values (2k+4,) of the state."""
    rest = values.copy()
    rest[number - 1] = np.inf
    second = int(rest.argmin())
    runner_up = actions[second] if np.isfinite(rest[second]) else None
    margin = max(float(rest[second] - values[number - 1]), 0.0)
    reason = _motive(mission, state, actions[number - 1])
    reason += f'; expected cost {values[number - 1]:.4g}'
    if runner_up is not None:
        reason += f', {margin:.2g} below {action_name(mission, runner_up)}'
    return Decision(
        state=tuple(state),
        action=actions[number - 1],
        runner_up=runner_up,
        values=tuple(values.tolist()),
        margin=margin,
        reason=reason,
        bounds=bounds,
    )


def _motive(mission: Mission, state: list[int], action: Action) -> str:
    s = StateSpace.of(mission).split(np.array(state))
    if action.goal is not None:
        goal, level = mission.goals[action.goal], PRIORITY_LEVELS[s.g[action.goal]]
        motive = f'{goal.name} has {level} priority'
    elif action.kind is ActionKind.RECHARGE:
        lost = [goal.name for goal, r in zip(mission.goals, state_flags(mission, s)) if not r]
        motive = f'out of range: {", ".join(lost) or "no goal"}'
        if mission.range.charge is not None:
            motive = f'charge {s.b[0]} of {mission.range.levels - 1}, {motive}'
    elif action.kind is ActionKind.REPAIR:
        motive = f'fault mode {FAULT_MODES[s.f - 1]}'
    elif not s.g.any():
        motive = 'no goal is wanted'
    else:
        motive = 'no goal is worth flying to now'
    return f'{motive}, threat {mission.threat.levels[s.t]}' if action.agile else motive
