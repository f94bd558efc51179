"""The table of a mission file's fields: the file is read by it, and its JSON Schema made of it."""

from __future__ import annotations

import math
from typing import Any

from uav_mission_manager.mdp import fields
from uav_mission_manager.mdp.battery_tables import ENERGY_TABLE, RANGE_TABLE
from uav_mission_manager.mdp.fields import Check
from uav_mission_manager.mdp.goal_tasks import TASK_TABLE
from uav_mission_manager.mdp.tables import Cells, Entries, Field, Table

MAX_CELLS = 1_000_000
"""Cells of a grid at most: a choice; one goal on so many takes a minute and gigabytes."""

_SIDE = fields.integer(1, MAX_CELLS)
_CELL: Check[Any] = Check(lambda value: value, fields.integer(0, MAX_CELLS - 1).schema)
"""Which cells there are is for the grid to say."""

_OLD_WORD = {'const': 'seed', 'deprecated': True, 'description': 'old word for paper'}
_STRICT_OR_PAPER = fields.one_of('strict', 'paper')
_FEASIBILITY: Check[Any] = Check(
    lambda value: value if value == 'seed' else _STRICT_OR_PAPER(value),
    {'anyOf': [_STRICT_OR_PAPER.schema, _OLD_WORD]},
)


def _parts(check: Check[float]) -> Table:
    return Table(
        tuple(Field(part, check, f'of the {part}') for part in ('sensor', 'actuator', 'camera'))
    )


_ORIGIN = Table(
    (
        Field('latitude', fields.latitude, '[deg]'),
        Field('longitude', fields.longitude, '[deg]'),
        # Dry land lies between -430 and 8850 m.
        Field('altitude', fields.within(-500.0, 9000.0), 'above mean sea level [m]'),
    )
)

_GRID = Table(
    (
        Field('rows', _SIDE, 'cells from north to south, unless it is turned'),
        Field('cols', _SIDE, 'cells from west to east, unless it is turned'),
        Field('base', _CELL, 'home cell; cells are numbered row by row from 0'),
        Field('service', _CELL, 'cell where the vehicle is recharged and repaired'),
        Field('cell_size', fields.positive, 'width of a cell [m]', 50.0),
        Field('origin', _ORIGIN, 'centre of cell 0; needed to fly', None),
        Field(
            'elevation',
            Cells(fields.within(-9000.0, 9000.0)),
            "by cell: its ground above the origin's altitude [m]",
            {},
        ),
        Field(
            'bearing',
            fields.within(-360.0, 360.0),
            'which way the first row lies from the last one, clockwise from north [deg]',
            0.0,
        ),
    )
)

_REQUESTS = Table(
    (
        Field('low', fields.non_negative, 'requests of low priority, while none is open [1/h]'),
        Field('high', fields.non_negative, 'requests of high priority, while none is open [1/h]'),
        Field('raised', fields.non_negative, 'how often an open low one becomes high [1/h]', 0.0),
        Field('lowered', fields.non_negative, 'how often an open high one becomes low [1/h]', 0.0),
        Field('withdrawn', fields.non_negative, 'how often an open one is withdrawn [1/h]', 0.0),
    )
)

_PRIORITIES = (
    Field(
        'priority_transition',
        fields.stochastic_matrix,
        'probabilities of priority 0, 1, 2 after an epoch; a row each from 0 (none), 1 (low), '
        '2 (high) [1]',
        None,
    ),
    Field('requests_per_hour', _REQUESTS, 'in place of priority_transition [1/h]', None),
)
ONE_WAY_OF_PRIORITIES = (('priority_transition',), ('requests_per_hour',))
"""How a goal, or the mission for all that have none of their own, says what is wanted."""

_BY_FAULT_MODE = fields.row(8, fields.probability)
_DONE_IN = fields.row(8, fields.positive_or('never', math.inf))

_GOAL = Table(
    (
        Field('name', fields.name, 'unique, without white space'),
        Field('cell', _CELL, 'where it is'),
        Field(
            'eta',
            fields.non_negative,
            'per unit of priority, while in range and not committed to [cost, see costs_per]',
        ),
        Field(
            'delta',
            fields.non_negative,
            'per unit of priority, while out of range [cost, see costs_per]',
        ),
        Field(
            'worth',
            fields.non_negative,
            'in place of eta and delta: while it is open, in range or not [cost per minute and '
            'unit of priority]',
        ),
        *_PRIORITIES,
        Field('completion', _BY_FAULT_MODE, 'in place of faults.completion [1]', None),
        Field(
            'done_in',
            fields.one_or_row(fields.positive, _DONE_IN),
            'in place of completion: with all in order, else in proportion to faults; or 8 [s]',
            None,
        ),
        Field(
            'task',
            TASK_TABLE,
            'what is done there; without, the vehicle stays for goal_dwell of the bridge',
            None,
        ),
        Field(
            'slot',
            fields.boolean,
            'whether a goal that is requested in flight may take its place',
            False,
        ),
        Field(
            'requested',
            fields.integer(0, 2),
            'written by the solver: priority that the goal in a slot was requested with',
            0,
        ),
        Field(
            'added',
            fields.boolean,
            'written by the solver: whether it was requested where no slot was free',
            False,
        ),
    ),
    ((('eta', 'delta'), ('worth',)), ONE_WAY_OF_PRIORITIES, (('completion',), ('done_in',))),
)

_FAULTS = Table(
    (
        Field('rate', _parts(fields.probability), 'of failing in an epoch of normal flight [1]'),
        Field(
            'mtbf',
            _parts(fields.positive),
            'in place of rate: mean time between failures, in normal flight [h]',
        ),
        Field(
            'agile_factor', _parts(fields.non_negative), 'how much likelier in agile flight [1]'
        ),
        Field(
            'repair_success',
            fields.probability,
            'probability that an epoch of repair succeeds [1]',
            1.0,
        ),
        Field('repair_in', fields.positive, 'in place of repair_success: mean time of one [s]'),
        Field(
            'completion',
            _BY_FAULT_MODE,
            'by fault mode: probability that an epoch in its cell completes a goal [1]',
        ),
        Field(
            'done_in',
            _DONE_IN,
            'in place of completion: mean time at a goal until it is done, or never [s]',
        ),
        Field('cost', fields.row(8, fields.non_negative), 'by fault mode [cost, see costs_per]'),
    ),
    (
        (('rate',), ('mtbf',)),
        (('repair_success',), ('repair_in',)),
        (('completion',), ('done_in',)),
    ),
)

_LASTS = Table(
    (
        Field('low', fields.positive, 'mean time for which a threat stays low [s]'),
        Field('high', fields.positive, 'mean time for which a threat stays high [s]'),
        Field('rises', fields.probability, 'share of low ones that go on as high [1]', 0.0),
        Field('falls', fields.probability, 'share of high ones that go on as low [1]', 0.0),
    )
)

_THREAT = Table(
    (
        Field('onset', fields.probability, 'of a threat in an epoch, in an ordinary cell [1]'),
        Field('zones', Cells(fields.probability), 'the same by cell [1]', {}),
        Field(
            'per_hour',
            fields.non_negative,
            'in place of onset: how often a threat comes in an ordinary cell [1/h]',
        ),
        Field(
            'zones_per_hour', Cells(fields.non_negative), 'in place of zones: by cell [1/h]', {}
        ),
        Field('high_share', fields.probability, 'share of threats that appear high [1]'),
        Field(
            'from_low',
            fields.distribution,
            'probabilities of none, low, high after an epoch of low [1]',
        ),
        Field(
            'from_high',
            fields.distribution,
            'probabilities of none, low, high after an epoch of high [1]',
        ),
        Field('lasts', _LASTS, 'in place of from_low and from_high'),
        Field(
            'cost',
            fields.matrix(3, fields.row(2, fields.non_negative)),
            'rows none, low, high; columns normal, agile flight [cost, see costs_per]',
        ),
    ),
    (
        (('onset',), ('per_hour',)),
        (('zones',), ('zones_per_hour',)),
        (('from_low', 'from_high'), ('lasts',)),
    ),
)

_SERVICE_COST = Table(
    (
        Field('recharge', fields.non_negative, '[cost, see costs_per]', 0.0),
        Field('repair', fields.non_negative, '[cost, see costs_per]', 0.0),
    )
)

_NO_FLY = Table(
    (
        Field('name', fields.name, 'unique, without white space'),
        Field('polygon', fields.polygon, 'corners [latitude, longitude], in order [deg]'),
    )
)

_AREAS = Table(
    (
        Field('fence', fields.polygon, 'to stay inside: corners, as of no_fly [deg]', None),
        Field('no_fly', Entries(_NO_FLY), 'to stay outside', None),
    )
)

_PRIORITY_WEIGHTS = Table(
    (
        Field('reward', fields.non_negative, 'of what a commitment saves [1]', 1.0),
        Field('urgency', fields.non_negative, 'of the priority [1]', 0.0),
        Field('risk', fields.non_negative, 'of arriving and completing without trouble [1]', 0.0),
        Field('resources', fields.non_negative, 'of a short way [1]', 0.0),
    )
)

_FLEET = Table(
    (
        Field(
            'preconditions',
            fields.by_name(fields.names),
            'by goal: the goals to be achieved before vehicles are sent to it',
            {},
        ),
        Field(
            'agents',
            fields.by_name(fields.integer(1)),
            'by goal: how many vehicles it needs at least; 1 for the rest',
            {},
        ),
        Field(
            'thresholds',
            fields.by_name(fields.positive),
            'by goal: expected reward from which it has vehicles enough [1]',
            {},
        ),
        Field('threshold', fields.positive, 'the same for all other goals [1]', 0.25),
        Field(
            'persistence',
            fields.non_negative,
            'how much more a vehicle gains by the goal that it pursues already, as a share [1]',
            0.1,
        ),
        Field('weights', _PRIORITY_WEIGHTS, 'of the priority scores that rank the goals', {}),
    )
)

MISSION_TABLE = Table(
    (
        Field('name', fields.name, 'of the mission, without white space'),
        Field('discount', fields.open_unit, 'weight of the next epoch to this one, gamma [1]'),
        Field('horizon', fields.positive, 'in place of discount: time for which costs count [s]'),
        Field(
            'costs_per',
            fields.one_of('epoch', 'minute'),
            'what all costs in the file are for, but for goals[].worth: always a minute',
            'epoch',
        ),
        Field(
            'feasibility',
            _FEASIBILITY,
            'commit, recharge and repair only where they make sense, or anywhere',
            'strict',
        ),
        Field('grid', _GRID, 'square cells, columns to the east, rows to the south'),
        Field('goals', Entries(_GOAL), 'what the mission is for'),
        *_PRIORITIES,
        Field('faults', _FAULTS, 'failures and what they do'),
        Field('range', RANGE_TABLE, 'goals that fall out of range'),
        Field('threat', _THREAT, 'threats'),
        Field(
            'distance_weight',
            fields.non_negative,
            'per cell width from the vehicle to its destination [cost, see costs_per]',
        ),
        Field('service_cost', _SERVICE_COST, 'at the service cell', {}),
        Field('energy', ENERGY_TABLE, 'range model, needed on board and for physical units', None),
        Field('areas', _AREAS, 'no part of the decision process; needs grid.origin', None),
        Field(
            'fleet',
            _FLEET,
            'for several vehicles that share the goals; no part of the decision process',
            {},
        ),
    ),
    ((('discount',), ('horizon',)), ONE_WAY_OF_PRIORITIES),
)
"""All fields of a mission file."""
