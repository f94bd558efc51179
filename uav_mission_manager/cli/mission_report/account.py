"""What a flight cost by the model, beside what was expected, and what made the difference.

With V the expected cost of the policy flown, J the stage cost, and the flight cut into the epochs
of the model,

    V(s_0) + sum_n discount^n (J_n + discount V(s_n+1) - V(s_n))
        = sum_n discount^n J_n + discount^N V(s_N)

so the cost paid, and what is left to pay at the end, is what was expected at the beginning and a
surprise for each epoch. A surprise is 0 in the mean where the model is right.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.cli.mission_report.flight_record import Decided, FlightRecord
from uav_mission_manager.cli.mission_report.story import Names, state_news
from uav_mission_manager.mdp import Mission, stage_costs
from uav_mission_manager.onboard import parse_command
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver.evaluation.forecast import epoch_length
from uav_mission_manager.solver.evaluation.simulation import simulate

MOST_EPOCHS_COUNTED = 100_000
"""Epochs of a flight that are counted, at most: a choice, days."""

MOST_EPOCHS_SIMULATED = 360
"""Epochs of a flight beside which others are simulated, at most: a choice, some seconds."""


@dataclass(frozen=True)
class Surprise:
    """What made the flight dearer, or cheaper if below 0, than was expected before.

    Attributes
    ----------
    at : float
        When [s]; NaN of many epochs together.
    cost : float
        Discounted to the beginning.
    text : str
    """

    at: float
    cost: float
    text: str


@dataclass(frozen=True)
class Account:
    """The costs of a flight, all discounted to its first decision.

    Attributes
    ----------
    start : float
        When that was [s].
    state : tuple of int
        In which it was.
    seconds : float
        Length of an epoch [s].
    epochs : int
    expected : float
        V at the first decision.
    at_least : float
        What any policy would have expected at least; NaN if not known.
    paid : float
        Stage costs of all epochs.
    left : float
        V at the end.
    surprises : tuple of Surprise
        They sum to paid + left - expected.
    """

    start: float
    state: tuple[int, ...]
    seconds: float
    epochs: int
    expected: float
    at_least: float
    paid: float
    left: float
    surprises: tuple[Surprise, ...]


def account_of(record: FlightRecord, mission: Mission, names: Names) -> Account | None:
    """Return the costs of a flight; None where it is too short for an epoch.

    An epoch without a decision counts as the last one with one.
    """
    decided = [each for each in record.decided if each.decision.state]
    if not decided or mission.energy is None:
        return None
    seconds, start = epoch_length(mission), decided[0].at
    epochs = min(math.floor((record.end - start) / seconds), MOST_EPOCHS_COUNTED)
    if epochs < 1:
        return None
    taken = _taken(decided, [start + seconds * n for n in range(epochs + 1)])
    states = np.array([each.decision.state for each in taken])
    numbers = [parse_command(mission, each.decision.command).number for each in taken]
    values = np.array([min(each.decision.values) for each in taken])
    stage = stage_costs(mission, states[:-1], np.array(numbers[:-1]))
    weight = mission.discount ** np.arange(epochs + 1)
    errors = weight[:-1] * (stage + mission.discount * values[1:] - values[:-1])
    return Account(
        start=start,
        state=decided[0].decision.state,
        seconds=seconds,
        epochs=epochs,
        expected=float(values[0]),
        at_least=decided[0].decision.lower_bound,
        paid=float(weight[:-1] @ stage),
        left=float(weight[-1] * values[-1]),
        surprises=_surprises(decided, taken, errors.tolist(), names),
    )


def _taken(decided: list[Decided], times: list[float]) -> list[Decided]:
    """Return the decision that held at each time."""
    starts = [each.at for each in decided]
    return [decided[bisect_right(starts, at) - 1] for at in times]


def as_dear(account: Account, policy: Policy, flights: int) -> float | None:
    """Return the share of simulated flights as long that cost as much or more.

    With what they are expected to cost after their end, as the flight itself. None where it is
    too long to be simulated.
    """
    if account.epochs > MOST_EPOCHS_SIMULATED:
        return None
    start = np.repeat(policy.space.check([account.state]), flights, axis=0)
    mission, rng = policy.mission, np.random.default_rng(0)
    costs, states = simulate(mission, policy.act, start, account.epochs, rng)
    left = mission.discount**account.epochs * policy.q_values(states).min(axis=1)
    return float((costs + left >= account.paid + account.left).mean())


def _surprises(
    decided: list[Decided], taken: list[Decided], errors: list[float], names: Names
) -> tuple[Surprise, ...]:
    """Name each by its news, or by the command that was slow; all others are summed."""
    found, quiet = [], dict[str, list[float]]()
    for error, before, after in zip(errors, taken, taken[1:]):
        news = '; '.join(state_news(before.decision, after.decision, names))
        if news:
            found.append(Surprise(_heard_at(decided, before, after, names), error, news))
        else:
            words = names.command(before.decision.command, before.decision)
            quiet.setdefault(words, []).append(error)
    others = []
    for words, costs in quiet.items():
        if sum(costs) > 0.0:
            text = f'{words}, {_epochs(costs)}: slower than the mission assumes'
            found.append(Surprise(math.nan, sum(costs), text))
        else:
            others += costs
    if others:
        text = f'{_epochs(others)} without news'
        found.append(Surprise(math.nan, sum(others), text))
    return tuple(sorted(found, key=lambda surprise: -abs(surprise.cost)))


def _epochs(costs: list[float]) -> str:
    return f'{len(costs):,} epoch{"s" if len(costs) > 1 else ""}'


def _heard_at(decided: list[Decided], before: Decided, after: Decided, names: Names) -> float:
    """Return when news of an epoch first counted."""
    return next(
        each.at
        for each in decided
        if each.at > before.at and any(state_news(before.decision, each.decision, names))
    )
