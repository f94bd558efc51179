"""The tables of a mission file's sections about the battery: `range` and `energy`."""

from __future__ import annotations

from typing import Any

from uav_mission_manager.mdp import fields
from uav_mission_manager.mdp.fields import Check
from uav_mission_manager.mdp.tables import Field, Table

MAX_LEVELS = 1000
"""Levels of a charge at most: a choice, finer than any gauge."""


def _modes(check: Check[Any]) -> Table:
    return Table(tuple(Field(mode, check, f'in {mode} flight') for mode in ('normal', 'agile')))


_DRAIN_ROW = fields.distribution_of(MAX_LEVELS)

_CHARGE = Table(
    (
        Field('levels', fields.integer(2, MAX_LEVELS), 'of the state of charge', 16),
        Field('reserve', fields.probability, 'state of charge that counts for no range [1]', 0.1),
        Field(
            'noise',
            fields.probability,
            'by how much an epoch of flight may take less or more energy, with probability 1/4 '
            'each [1]',
            0.2,
        ),
        Field(
            'drain',
            _modes(_DRAIN_ROW),
            'in place of noise: probabilities that an epoch of flight drains 0, 1, .. levels [1]',
        ),
        Field(
            'rate',
            fields.integer(1, MAX_LEVELS),
            'levels that an epoch of recharging adds; without, it is full at once',
            None,
        ),
        Field(
            'empty_cost',
            fields.non_negative,
            'of flying on an empty battery, besides [cost, see costs_per]',
        ),
    ),
    ((('noise',), ('drain',)),),
)

RANGE_TABLE = Table(
    (
        Field(
            'loss',
            _modes(fields.probability),
            'probability that a goal falls out of range in an epoch of flight [1]',
        ),
        Field(
            'lasts',
            _modes(fields.positive),
            'in place of loss: mean time of flight until a goal falls out of range [s]',
        ),
        Field(
            'charge',
            _CHARGE,
            'in place of loss: one battery, whose charge tells what is in range; needs energy',
        ),
        Field(
            'cost',
            fields.non_negative,
            'with all goals out of range, shared over them [cost, see costs_per]',
        ),
    ),
    ((('loss',), ('lasts',), ('charge',)),),
)

ENERGY_TABLE = Table(
    (
        Field('capacity', fields.positive, 'of the battery [Ah]'),
        Field('voltage', fields.positive, 'of the battery [V]'),
        Field('power', fields.positive, 'drawn in flight [W]'),
        Field('speed', fields.positive, 'cruise speed; with cell_size it tells an epoch [m/s]'),
        Field('wind', fields.non_negative, 'worst wind [m/s]'),
        Field('wind_penalty', fields.non_negative, 'range lost to wind [m/(m/s)]'),
        Field('payload', fields.non_negative, 'mass [kg]'),
        Field('payload_penalty', fields.non_negative, 'range lost to it [m/kg]'),
        Field('agile_power', fields.positive, 'drawn in agile flight; without, power [W]', None),
        Field('agile_speed', fields.positive, 'in agile flight; without, speed [m/s]', None),
    )
)
