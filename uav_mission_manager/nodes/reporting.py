"""What the manager knows and decides, as messages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header

from uav_mission_manager.console.heard import CHARGE_LEVEL, IN_RANGE, PRIORITY
from uav_mission_manager.echo import shown
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.mdp import (
    FAULT_MODES,
    PRIORITY_LEVELS,
    Grid,
    Mission,
    StateSpace,
    action_name,
    global_actions,
)
from uav_mission_manager.mdp.charge import state_flags
from uav_mission_manager.mdp.range_model import flight_range
from uav_mission_manager.onboard import Refusal, Situation, format_command
from uav_mission_manager.onboard.inputs import silence
from uav_mission_manager.policy import Decision, Policy

LONGEST_TEXT = 2000
"""Characters of a message or value in the diagnostics: a choice, ten that are cut where they come
from, and the values of all actions of a mission of a hundred goals."""

KEPT_INPUTS = ('threat_level', 'goal_priorities')
"""Inputs whose last value stays in force however old it is; the diagnostics warn of its age."""


def status(level: bytes, name: str, message: str, **values: object) -> DiagnosticStatus:
    """Return a diagnostic status with its values as text, in one line each."""
    pairs = [
        KeyValue(key=shown(key), value=shown(value, LONGEST_TEXT)) for key, value in values.items()
    ]
    text = shown(message, LONGEST_TEXT)
    return DiagnosticStatus(level=level, name=name, message=text, values=pairs)


def decision_status(
    name: str,
    outcome: Decision | Refusal,
    situation: Situation,
    now: float,
    digest: str,
) -> DiagnosticStatus:
    """Return why the manager decided as it did, or why it did not decide."""
    ages = {f'age {topic} [s]': f'{age:.2f}' for topic, age in situation.ages(now).items()}
    refused = ', '.join(situation.refused_goals) or 'none'
    if isinstance(outcome, Refusal):
        return status(
            DiagnosticStatus.ERROR,
            name,
            outcome.reason,
            refused_goals=refused,
            policy=digest,
            **ages,
        )
    mission = situation.mission
    runner_up = outcome.runner_up
    words = state_in_words(mission, outcome.state)
    return status(
        DiagnosticStatus.OK,
        name,
        outcome.reason,
        state=' '.join(map(str, outcome.state)),
        command=format_command(mission, outcome.action),
        action=outcome.action.number,
        refused_goals=refused,
        runner_up='none' if runner_up is None else format_command(mission, runner_up),
        values=' '.join(f'{value:.6g}' for value in outcome.values),
        margin=f'{outcome.margin:.6g}',
        lower_bound=f'{outcome.lower_bound:.6g}',
        upper_bound=f'{outcome.upper_bound:.6g}',
        policy=digest,
        **words,
        **_measured(situation),
        **_costs(mission, outcome.values),
        **ages,
    )


def state_in_words(mission: Mission, state: Sequence[int]) -> dict[str, str]:
    """Return each variable of a state by a name, with its value in words, and the range flags."""
    s = StateSpace.of(mission).split(np.array(state))
    row, col = divmod(int(s.l), mission.grid.cols)
    goals = [goal.name for goal in mission.goals]
    flags, charge = state_flags(mission, s), dict[str, str]()
    if mission.range.charge is not None:
        charge[CHARGE_LEVEL] = f'{s.b[0]} of 0 to {mission.range.levels - 1}'
    return {
        'fault mode': FAULT_MODES[s.f - 1],
        **charge,
        **{f'{goal}{IN_RANGE}': 'yes' if r else 'no' for goal, r in zip(goals, flags)},
        **{f'{goal}{PRIORITY}': PRIORITY_LEVELS[g] for goal, g in zip(goals, s.g)},
        'cell': f'{s.l}, column {col} and row {row} from 0',
        'committed to': goals[s.c - 1] if s.c else 'no goal',
        'threat': mission.threat.levels[s.t],
        'flight mode': 'agile' if s.m else 'normal',
    }


def charge_left(situation: Situation) -> float | None:
    """Return the charge (0 to 1) of the battery that counts; 0 where it is reported unhealthy."""
    energy = situation.mission.energy
    battery = energy and situation.batteries.worst(energy)
    if not (energy and battery):
        return None
    return battery.charge(energy) if battery.report.healthy else 0.0


def _measured(situation: Situation) -> dict[str, str]:
    """Return what the range follows from, with units."""
    values = {}
    charge, energy = charge_left(situation), situation.mission.energy
    if charge is not None and energy is not None:
        values['charge [%]'] = f'{100.0 * charge:.1f}'
        values['range [m]'] = f'{flight_range(energy, charge):.0f}'
    if situation.position is not None:
        east, north = situation.position
        values |= {'east [m]': f'{east:.1f}', 'north [m]': f'{north:.1f}'}
    return values


def _costs(mission: Mission, values: Sequence[float]) -> dict[str, str]:
    """Return the expected cost of each action by its name."""
    return {
        f'cost of {action_name(mission, action)}': (
            f'{value:.6g}' if math.isfinite(value) else 'not allowed'
        )
        for action, value in zip(global_actions(mission), values, strict=True)
    }


def manager_health(
    name: str,
    used: tuple[str, Policy],
    outcome: Decision | Refusal,
    situation: Situation,
    complaints: Mapping[str, str],
    troubles: Mapping[str, str],
    now: float,
    timeout: float,
) -> list[DiagnosticStatus]:
    """Return how the manager is: its policy and inputs, and what else there is to say.

    Parameters
    ----------
    name : str
        Of the node.
    used : tuple of str and Policy
        Where the policy is from, and the policy.
    outcome : Decision or Refusal
    situation : Situation
    complaints : mapping
        What is wrong with messages, by topic.
    troubles : mapping
        What is wrong with other parts, by part; empty if nothing.
    now, timeout : float
        Time, and the age above which an input is old [s].
    """
    ok, warn, error = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
    path, policy = used
    bad_policy = complaints.get('policy_set', '')
    ages = situation.ages(now)
    notes = [text for topic, text in complaints.items() if topic != 'policy_set']
    notes += situation.warnings
    notes += [
        f'{topic} {ages[topic]:.1f} s old, its last value kept'
        for topic in KEPT_INPUTS
        if ages.get(topic, 0.0) > timeout
    ]
    level, link = ok, 'all inputs fresh'
    if why := silence(ages, timeout):
        level, link = error, why
    elif isinstance(outcome, Refusal):  # Before anything is asked for, this is as it should be.
        level, link = error if 'goal_priorities' in situation.known else warn, outcome.reason
    details = {topic: f'{age:.2f} s' for topic, age in ages.items()}
    return [
        status(
            warn if bad_policy else ok,
            f'{name}: policy',
            bad_policy or path,
            digest=policy.digest,
            method=policy.method,
        ),
        status(
            warn if notes else ok, f'{name}: inputs', '; '.join(notes) or 'all good', **details
        ),
        status(level, f'{name}: link', link),
        *(
            status(warn if trouble else ok, f'{name}: {part}', trouble or 'all good')
            for part, trouble in troubles.items()
        ),
    ]


def cell_pose(grid: Grid, cell: int, stamp: Time) -> PoseStamped:
    """Return the centre of a cell in `map`."""
    message = PoseStamped(header=Header(stamp=stamp, frame_id=MAP_FRAME))
    message.pose.position.x, message.pose.position.y = grid.position(cell)
    message.pose.orientation.w = 1.0
    return message
