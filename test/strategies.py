"""Missions for the tests: the shipped one, cuts of it, and random ones from Hypothesis."""

from __future__ import annotations

import copy

import numpy as np
import yaml
from hypothesis import strategies as st

from uav_mission_manager.paths import share_directory

CASE_STUDY = share_directory() / 'config' / 'case_study.yaml'
PARTS = ('sensor', 'actuator', 'camera')
UNITLESS = {
    '': ('discount', 'priority_transition'),
    'faults': ('rate', 'repair_success', 'completion'),
    'range': ('loss',),
    'threat': ('onset', 'zones', 'from_low', 'from_high'),
}
"""Fields per epoch that have a twin in physical units, by section."""

_DOCUMENT = yaml.safe_load(CASE_STUDY.read_text())


def case_study(*goals, **changes):
    """Parsed case study, cut to the given goals (from 1; all by default), some fields changed."""
    document = copy.deepcopy(_DOCUMENT) | changes
    if goals:
        document['goals'] = [document['goals'][j - 1] for j in goals]
    return document


def in_units(**changes):
    """The case study with everything that can be in physical units; an epoch takes 10 s."""
    document = case_study(costs_per='minute', horizon=600.0, **changes)
    for section, keys in UNITLESS.items():
        for key in keys:
            del (document[section] if section else document)[key]
    document['requests_per_hour'] = {
        'low': 6.0,
        'high': 3.0,
        'raised': 4.0,
        'lowered': 2.0,
        'withdrawn': 1.0,
    }
    document['goals'][0] |= {'worth': 3.0, 'done_in': 25.0}
    del document['goals'][0]['eta'], document['goals'][0]['delta']
    document['faults'] |= {
        'mtbf': {'sensor': 50.0, 'actuator': 20.0, 'camera': 0.5},
        'repair_in': 30.0,
        'done_in': [12.0, 15.0, 20.0, 40.0, *['never'] * 4],
    }
    document['range']['lasts'] = {'normal': 600.0, 'agile': 240.0}
    document['threat'] |= {
        'per_hour': 12.0,
        'zones_per_hour': {0: 0.0, 1: 0.0, 2: 90.0, 6: 90.0},
        'lasts': {'low': 25.0, 'high': 40.0, 'rises': 0.3, 'falls': 0.5},
    }
    return document


def lively(**changes):
    """Two goals in three cells, every probability far from 0 and 1."""
    document = case_study(
        1,
        2,
        grid={'rows': 1, 'cols': 3, 'base': 0, 'service': 2},
        priority_transition=[[0.5, 0.3, 0.2], [0.3, 0.4, 0.3], [0.2, 0.3, 0.5]],
        **changes,
    )
    document['goals'][0]['cell'], document['goals'][1]['cell'] = 1, 1
    document['faults'] |= {
        'rate': dict.fromkeys(PARTS, 0.3),
        'completion': [0.5] * 8,
        'repair_success': 0.6,
    }
    document['range']['loss'] = {'normal': 0.3, 'agile': 0.6}
    document['threat'] |= {
        'onset': 0.3,
        'high_share': 0.4,
        'from_low': [0.5, 0.3, 0.2],
        'from_high': [0.2, 0.3, 0.5],
    }
    document['threat'].pop('zones')
    return document


def with_charge(document, **changes):
    """The mission with one battery of six levels in place of range flags.

    About one level is drained in an epoch, more in agile flight, and what is in range differs
    from level to level.
    """
    document = copy.deepcopy(document)
    cell = document['grid'].get('cell_size', 50.0)
    document['energy'] = {
        'capacity': 1.0,
        'voltage': 10.0,
        'power': 600.0,
        'speed': cell / 10.0,
        'wind': 2.0,
        'wind_penalty': cell / 20.0,
        'payload': 1.0,
        'payload_penalty': cell / 20.0,
        'agile_power': 900.0,
        'agile_speed': cell / 9.0,
    }
    charge = {'levels': 6, 'reserve': 0.05, 'empty_cost': 7.0} | changes
    document['range'] = {'cost': document['range']['cost'], 'charge': charge}
    return document


def pick_states(space, count, seed=0):
    """Rows of distinct random states."""
    rng = np.random.default_rng(seed)
    return space.states(rng.choice(space.size, count, replace=False))


probabilities = st.sampled_from([0.0, 1.0]) | st.floats(0.0, 1.0)
costs = st.just(0.0) | st.integers(0, 20) | st.floats(0.0, 100.0)
factors = st.sampled_from([0.0, 1.0]) | st.floats(0.0, 50.0)


def rows(entries, length):
    return st.lists(entries, min_size=length, max_size=length)


distributions = rows(st.integers(0, 9), 3).map(
    lambda weights: [w / sum(weights) for w in weights] if any(weights) else [1.0, 0.0, 0.0]
)
matrices = rows(distributions, 3)


@st.composite
def goals(draw, cells, k, shared):
    """k goals, each with a priority transition of its own unless the mission has a shared one.

    Some have a completion of their own.
    """
    entries = []
    for j in range(1, k + 1):
        goal = {'name': f'goal{j}', 'cell': draw(cells), 'eta': draw(costs), 'delta': draw(costs)}
        if not shared or draw(st.booleans()):
            goal['priority_transition'] = draw(matrices)
        if draw(st.booleans()):
            goal['completion'] = draw(rows(probabilities, 8))
        entries.append(goal)
    return entries


faults = st.fixed_dictionaries(
    {
        'rate': st.fixed_dictionaries(dict.fromkeys(PARTS, probabilities)),
        'agile_factor': st.fixed_dictionaries(dict.fromkeys(PARTS, factors)),
        'completion': rows(probabilities, 8),
        'cost': rows(costs, 8),
    },
    optional={'repair_success': probabilities},
)


def threats(cells):
    return st.fixed_dictionaries(
        {
            'onset': probabilities,
            'high_share': probabilities,
            'from_low': distributions,
            'from_high': distributions,
            'cost': rows(rows(costs, 2), 3),
        },
        optional={'zones': st.dictionaries(cells, probabilities, max_size=4)},
    )


positive = st.floats(1e-3, 1e3)
energies = st.fixed_dictionaries(
    {
        **dict.fromkeys(('capacity', 'voltage', 'power', 'speed'), positive),
        **dict.fromkeys(('wind', 'wind_penalty', 'payload', 'payload_penalty'), costs),
    }
)
origins = st.fixed_dictionaries(
    {
        'latitude': st.floats(-80, 80),
        'longitude': st.floats(-180, 180),
        'altitude': st.floats(-500, 9000),
    }
)


def places(cells):
    elevations = st.dictionaries(cells, st.floats(-9000, 9000), max_size=4)
    return st.fixed_dictionaries(
        {},
        optional={
            'cell_size': positive,
            'origin': origins,
            'elevation': elevations,
            'bearing': st.floats(-360, 360),
        },
    )


@st.composite
def missions(draw, sizes, goal_counts):
    """Any valid mission file, parsed, with a grid of one of the sizes (rows, columns).

    Base, service and goals may share cells; every optional part may be absent.
    """
    rows_, cols = draw(st.sampled_from(sizes))
    cells = st.integers(0, rows_ * cols - 1)
    shared = draw(st.booleans())
    document = {
        'name': 'random',
        'discount': draw(st.floats(0.05, 0.95)),
        'grid': {
            'rows': rows_,
            'cols': cols,
            'base': draw(cells),
            'service': draw(cells),
            **draw(places(cells)),
        },
        'goals': draw(goals(cells, draw(st.sampled_from(goal_counts)), shared)),
        'faults': draw(faults),
        'range': {
            'loss': {'normal': draw(probabilities), 'agile': draw(probabilities)},
            'cost': draw(costs),
        },
        'threat': draw(threats(cells)),
        'distance_weight': draw(costs),
    }
    if shared:
        document['priority_transition'] = draw(matrices)
    optional = st.fixed_dictionaries(
        {},
        optional={
            'feasibility': st.sampled_from(['strict', 'paper']),
            'service_cost': st.fixed_dictionaries(
                {}, optional={'recharge': costs, 'repair': costs}
            ),
            'energy': energies,
        },
    )
    return document | draw(optional)


charges = st.fixed_dictionaries(
    {'levels': st.integers(2, 6), 'empty_cost': costs},
    optional={
        'reserve': st.floats(0.0, 0.4),
        'rate': st.integers(1, 6),
        'noise': probabilities,
    },
)


@st.composite
def charged_missions(draw, sizes, goal_counts):
    """Any valid mission file with one battery, parsed."""
    document = with_charge(draw(missions(sizes, goal_counts)), **draw(charges))
    if draw(st.booleans()):
        weights = st.lists(st.integers(1, 9), min_size=1, max_size=8)
        rows = {mode: draw(weights) for mode in ('normal', 'agile')}
        document['range']['charge'].pop('noise', None)
        document['range']['charge']['drain'] = {
            mode: [weight / sum(row) for weight in row] for mode, row in rows.items()
        }
    return document
