"""What will probably happen in flights of a policy, and how that of another one differs.

All numbers are of the first `FORECAST_MINUTES`, but for the discounted cost, which has no end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uav_mission_manager.mdp import FAULT_MODES, Mission
from uav_mission_manager.mdp.arrays import AnyArray, BoolArray, FloatArray
from uav_mission_manager.mdp.dynamics import ON_GROUND, Regime, completion_probabilities
from uav_mission_manager.mdp.energy import Energy
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR, SECONDS_PER_MINUTE, Epoch
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.solver.evaluation.flights import MOST_EPOCHS, Flights
from uav_mission_manager.solver.evaluation.intervals import (
    Interval,
    mean,
    median,
    proportion,
    proportion_difference,
)

WITHIN_MINUTES = (5, 10, 30)
"""Times by which goals may be done [min]: a choice."""

FORECAST_MINUTES = WITHIN_MINUTES[-1]
"""Length of what is forecast [min]."""

Statistic = Callable[..., Interval]
"""What makes an interval of one or two samples."""

ROUNDING = 1 + 1e-12
"""Factor of a limit that rounding alone does not pass."""


@dataclass(frozen=True)
class GoalForecast:
    """When a goal is done.

    Attributes
    ----------
    name : str
    done_within : dict of int to Interval
        Probability that it is done within so many minutes.
    minutes : Interval
        Mean time until it is done [min], counted as `FORECAST_MINUTES` where it is not.
    median_minutes : Interval or None
        Median time until it is done [min], infinite where that is beyond `FORECAST_MINUTES`;
        None of a difference.
    withdrawn : Interval
        Probability that the base station withdraws it before it is done.
    """

    name: str
    done_within: dict[int, Interval]
    minutes: Interval
    median_minutes: Interval | None
    withdrawn: Interval


@dataclass(frozen=True)
class Forecast:
    """What will probably happen.

    Attributes
    ----------
    goals : tuple of GoalForecast
    means : dict of str to Interval
        `recharges`, `repairs` (tries), `agile_minutes`, `air_minutes`, `energy_wh`.
    events : dict of str to Interval
        Probabilities of `actuator_failed`, `no_goal_possible` (a fault mode in which no goal is
        ever completed) and `full_charge_drawn` (more than a full battery holds, from one recharge
        to the next).
    cost : Interval
        Discounted cost.
    """

    goals: tuple[GoalForecast, ...]
    means: dict[str, Interval]
    events: dict[str, Interval]
    cost: Interval


def epoch_length(mission: Mission) -> float:
    """Length of an epoch [s]. Raises `Bad` where it is not known."""
    return Epoch(mission.grid.cell_size, _energy(mission).speed).length


def epochs_within(mission: Mission, minutes: float) -> int:
    """Epochs that end within some minutes. Raises `Bad` where their length is not known."""
    # Room for rounding: three epochs of 10 s do end within half a minute.
    return math.floor(minutes * SECONDS_PER_MINUTE / epoch_length(mission) * ROUNDING)


def forecast_epochs(mission: Mission) -> int:
    """Epochs of a forecast.

    Raises
    ------
    Bad
        If their length is not known, or they are none or more than can be simulated.
    """
    epochs = epochs_within(mission, FORECAST_MINUTES)
    if not 1 <= epochs <= MOST_EPOCHS:
        raise Bad(
            f'grid.cell_size {mission.grid.cell_size:g} m and energy.speed '
            f'{_energy(mission).speed:g} m/s: {FORECAST_MINUTES} minutes are {epochs} epochs, '
            f'not 1 to {MOST_EPOCHS:,}'
        )
    return epochs


def forecast(flights: Flights) -> Forecast:
    """Estimate what will happen."""
    found = _forecast((flights,), proportion, _mean_above_zero)
    goals = tuple(
        replace(goal, median_minutes=median(minutes_until_done(flights)[:, j]))
        for j, goal in enumerate(found.goals)
    )
    return replace(found, goals=goals)


def difference(first: Flights, second: Flights) -> Forecast:
    """Estimate the second's less the first's, of pairs of flights that met with the same luck."""
    return _forecast((first, second), proportion_difference, _mean_difference)


def minutes_until_done(flights: Flights) -> FloatArray:
    """Time until each goal is done [min], inf where it is not, shape (N, k)."""
    minutes = flights.done * (epoch_length(flights.mission) / SECONDS_PER_MINUTE)
    return np.where(flights.done > 0, minutes, math.inf)


def _forecast(runs: tuple[Flights, ...], share: Statistic, average: Statistic) -> Forecast:
    """Apply statistics of one or two samples to all that is measured."""

    def over(statistic: Statistic, measure: Callable[..., Any], *of: int) -> Interval:
        return statistic(*(measure(run, *of) for run in runs))

    goals = tuple(
        GoalForecast(
            name=goal.name,
            done_within={limit: over(share, _done_within, j, limit) for limit in WITHIN_MINUTES},
            minutes=over(average, _minutes, j),
            median_minutes=None,
            withdrawn=over(share, _withdrawn, j),
        )
        for j, goal in enumerate(runs[0].mission.goals)
    )
    cost = over(average, _costs)
    return Forecast(
        goals=goals,
        means={name: over(average, measure) for name, measure in MEASURED_MEANS.items()},
        events={name: over(share, measure) for name, measure in MEASURED_EVENTS.items()},
        cost=Interval(
            cost.value,
            cost.low - (runs[0].cost_left if runs[1:] else 0.0),
            cost.high + runs[-1].cost_left,
        ),
    )


def _mean_above_zero(samples: AnyArray) -> Interval:
    found = mean(samples)
    return replace(found, low=max(found.low, 0.0))


def _mean_difference(first: AnyArray, second: AnyArray) -> Interval:
    return mean(second - first)


def _done_within(flights: Flights, goal: int, minutes: float) -> BoolArray:
    done = flights.done[:, goal]
    return (done > 0) & (done <= epochs_within(flights.mission, minutes))


def _minutes(flights: Flights, goal: int) -> FloatArray:
    return np.minimum(minutes_until_done(flights)[:, goal], FORECAST_MINUTES)


def _withdrawn(flights: Flights, goal: int) -> BoolArray:
    return flights.withdrawn[:, goal]


def _costs(flights: Flights) -> FloatArray:
    return flights.costs


def _energy(mission: Mission) -> Energy:
    if mission.energy is None:
        raise Bad('energy: is missing; an epoch lasts for grid.cell_size / energy.speed')
    return mission.energy


def _epoch_energy(mission: Mission, agile: bool = False) -> float:
    """Energy of an epoch in the air [Wh]."""
    energy = _energy(mission)
    if not agile or energy.agile_power is energy.agile_speed is None:
        return energy.power * epoch_length(mission) / SECONDS_PER_HOUR
    length = mission.grid.cell_size / (energy.agile_speed or energy.speed)
    return (energy.agile_power or energy.power) * length / SECONDS_PER_HOUR


def _energy_drawn(flights: Flights) -> FloatArray:
    agile = flights.regime_epochs[:, Regime.AGILE_FLIGHT]
    normal = _air_epochs(flights) - agile
    of_normal, of_agile = (_epoch_energy(flights.mission, mode) for mode in (False, True))
    return np.asarray(normal * of_normal + agile * of_agile)


def _air_epochs(flights: Flights) -> AnyArray:
    grounded = flights.regime_epochs[:, ON_GROUND].sum(axis=1)
    return np.asarray(flights.epochs - grounded)


def _minutes_of(epochs: AnyArray, flights: Flights) -> FloatArray:
    return np.asarray(epochs * (epoch_length(flights.mission) / SECONDS_PER_MINUTE))


def _actuator_failed(flights: Flights) -> BoolArray:
    failed = [name == 'all' or 'actuator' in name for name in FAULT_MODES]
    return np.asarray(flights.fault_modes[:, failed].any(axis=1))


def _no_goal_possible(flights: Flights) -> BoolArray:
    hopeless = (completion_probabilities(flights.mission) == 0).all(axis=0)
    return np.asarray(flights.fault_modes[:, hopeless].any(axis=1))


def _full_charge_drawn(flights: Flights) -> BoolArray:
    energy = _energy(flights.mission)
    full = energy.capacity * energy.voltage * ROUNDING
    return np.asarray(flights.longest_flight * _epoch_energy(flights.mission) > full)


MEASURED_MEANS: dict[str, Callable[[Flights], AnyArray]] = {
    'recharges': lambda flights: flights.regime_epochs[:, Regime.RECHARGED],
    'repairs': lambda flights: flights.regime_epochs[:, Regime.REPAIRED],
    'agile_minutes': lambda flights: _minutes_of(
        flights.regime_epochs[:, Regime.AGILE_FLIGHT], flights
    ),
    'air_minutes': lambda flights: _minutes_of(_air_epochs(flights), flights),
    'energy_wh': _energy_drawn,
}
"""What is counted in each flight, by its name in `Forecast.means`."""

MEASURED_EVENTS: dict[str, Callable[[Flights], BoolArray]] = {
    'actuator_failed': _actuator_failed,
    'no_goal_possible': _no_goal_possible,
    'full_charge_drawn': _full_charge_drawn,
}
"""What happens in some flights, by its name in `Forecast.events`."""
