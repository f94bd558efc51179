"""The numbers of a mission about its battery: range model, and what takes goals out of range."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ByMode:
    """A number for flight in normal and in agile mode."""

    normal: float
    agile: float


@dataclass(frozen=True)
class Drain:
    """P(d) of the levels d = 0, 1, .. that an epoch of flight drains, by mode."""

    normal: tuple[float, ...]
    agile: tuple[float, ...]


@dataclass(frozen=True)
class Charge:
    """The battery as the model has it: the state of charge in levels, b = 0..levels-1.

    Attributes
    ----------
    levels : int
        At least 2. Level b stands for the state of charge from b / levels on.
    reserve : float
        State of charge (0 to 1) that counts for no range.
    drain : Drain
    empty_cost : float
        Cost of an epoch of flight with b = 0, on top of all others.
    rate : int or None
        Levels that an epoch of recharging adds; None for all.
    """

    levels: int
    reserve: float
    drain: Drain
    empty_cost: float
    rate: int | None = None


@dataclass(frozen=True)
class Range:
    """What takes goals out of range, and the cost beta of lost range.

    Attributes
    ----------
    cost : float
    loss : ByMode or None
        P(r_j: 1 -> 0) an epoch in flight: each range flag is a variable of its own.
    charge : Charge or None
        In place of `loss`: one charge, which tells all range flags.
    """

    cost: float
    loss: ByMode | None = None
    charge: Charge | None = None

    def __post_init__(self) -> None:
        """Raise `ValueError` unless there is one of loss and charge."""
        if (self.loss is None) == (self.charge is None):
            raise ValueError('range: needs one of loss and charge')

    @property
    def flag_values(self) -> int:
        """Values of a range flag as a variable of its own: 2, or 1 where the charge tells it."""
        return 1 if self.charge else 2

    @property
    def levels(self) -> int:
        """Values of the charge as a variable: 1 where it is none."""
        return self.charge.levels if self.charge else 1


@dataclass(frozen=True)
class Energy:
    """Numbers of the range model (see `uav_mission_manager.mdp.range_model`).

    Attributes
    ----------
    capacity, voltage, power : float
        b_c [Ah], v [V], P [W].
    speed : float
        beta, cruise speed [m/s].
    wind, wind_penalty : float
        q, worst wind [m/s], and k1, range lost to it [m/(m/s)].
    payload, payload_penalty : float
        Payload mass [kg] and k2, range lost to it [m/kg].
    agile_power, agile_speed : float or None
        Power [W] and speed [m/s] in agile flight; None for those of normal flight.
    """

    capacity: float
    voltage: float
    power: float
    speed: float
    wind: float
    wind_penalty: float
    payload: float
    payload_penalty: float
    agile_power: float | None = None
    agile_speed: float | None = None
