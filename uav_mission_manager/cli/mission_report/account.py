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
from uav_mission_manager.solver.evaluation.forecast import epoch_length

MOST_EPOCHS_COUNTED = 100_000
"""Epochs of a flight that are counted, at most: a choice, days."""


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
    seconds : float
        Length of an epoch [s].
    epochs : int
    expected : float
        V at the first decision.
    paid : float
        Stage costs of all epochs.
    left : float
        V at the end.
    surprises : tuple of Surprise
        They sum to paid + left - expected.
    """

    start: float
    seconds: float
    epochs: int
    expected: float
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
        seconds=seconds,
        epochs=epochs,
        expected=float(values[0]),
        paid=float(weight[:-1] @ stage),
        left=float(weight[-1] * values[-1]),
        surprises=_surprises(taken, errors.tolist(), names),
    )


def _taken(decided: list[Decided], times: list[float]) -> list[Decided]:
    """Return the decision that held at each time."""
    starts = [each.at for each in decided]
    return [decided[bisect_right(starts, at) - 1] for at in times]


def _surprises(taken: list[Decided], errors: list[float], names: Names) -> tuple[Surprise, ...]:
    """Name each by the news in its epoch; epochs without any are summed by command."""
    found, quiet = [], dict[str, float]()
    for error, (_, before), (at, after) in zip(errors, taken, taken[1:]):
        news = '; '.join(state_news(before, after, names))
        if news:
            found.append(Surprise(at, error, news))
        else:
            words = names.command(before.command, before)
            quiet[words] = quiet.get(words, 0.0) + error
    found += [
        Surprise(math.nan, cost, f'{words}: all epochs without news')
        for words, cost in quiet.items()
    ]
    return tuple(sorted(found, key=lambda surprise: -abs(surprise.cost)))
