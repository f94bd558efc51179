"""The JSON Schema of mission files says what the loader does, as far as a schema can."""

from __future__ import annotations

import copy
import json
import re

import jsonschema
import pytest
import yaml
from hypothesis import given
from strategies import case_study, charged_missions, in_units, missions

from uav_mission_manager.mdp import MissionError, mission_from_dict
from uav_mission_manager.mdp.mission_schema import mission_schema
from uav_mission_manager.paths import share_directory

SHARE = share_directory()
SCHEMA_FILE = SHARE / 'config' / 'mission.schema.json'
SHIPPED = [*sorted((SHARE / 'config').glob('case_*.yaml')), SHARE / 'config' / 'survey.yaml']
TESTED = sorted((SHARE / 'test' / 'missions').glob('*.yaml'))
VALIDATOR = jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text()))

GRIDS = [(1, 1), (2, 3), (4, 5)]

NOT_IN_A_SCHEMA = re.compile(
    r'sums to|no cell of|names a cell that|name of another goal|shorter than an epoch|too coarse'
    r'|corner \d+ is where|cross or touch|is below 1 m2|areas: need'
    r'|[0-9]\.[0-9]+ is not a whole number|energy\.speed|a discount of|off the|m from the centre'
    r'|needs grid\.origin|needs the section energy|a full battery lasts|needs 8 values'
)
"""What the loader says of files that the schema accepts."""


def schema_accepts(document):
    return VALIDATOR.is_valid(json.loads(json.dumps(document)))


def refusal(document):
    """What the loader says of a document, or None."""
    try:
        mission_from_dict(document, 'test')
    except MissionError as error:
        return str(error)
    return None


def test_the_shipped_schema_is_up_to_date():
    """If not: `make schema`."""
    assert json.loads(SCHEMA_FILE.read_text()) == mission_schema()


def test_it_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(mission_schema())


@pytest.mark.parametrize('file', [*SHIPPED, *TESTED], ids=lambda file: file.stem)
def test_it_accepts_mission_files(file):
    assert schema_accepts(yaml.safe_load(file.read_text()))


@pytest.mark.parametrize('file', SHIPPED, ids=lambda file: file.stem)
def test_editors_find_it_from_the_shipped_missions(file):
    [name] = re.findall(r'^# yaml-language-server: \$schema=(.*)$', file.read_text(), re.MULTILINE)
    assert (file.parent / name) == SCHEMA_FILE


@given(missions(GRIDS, [1, 2, 5]) | charged_missions(GRIDS, [1, 2, 5]))
def test_it_accepts_every_mission(document):
    assert schema_accepts(document)
    assert schema_accepts(mission_from_dict(document, 'test').to_dict())


def places(node, place=()):
    """Every field of a document, and every entry of a list."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        yield (*place, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*place, key))


def parent(document, place):
    for key in place[:-1]:
        document = document[key]
    return document


BAD = [-1, -0.5, 0, 0.5, 1, 1.5, 7, 100, 2_000_000, 1e9, True, None, 'x', 'two words', 'never', '']
BAD += ['strict', 'paper', 'seed', 'epoch', [], [0.5], [0.5] * 3, [[1.0, 0.0, 0.0]] * 3, {}]
BAD += [{'low': 1}, {'2': 0.5}, {'-1': 0.5}, {'02': 0.5}, 'x' * 101]


def variants(document):
    """The document with one thing changed: a field replaced, left out or added."""
    for place in [*places(document)]:
        for value in BAD:
            other = copy.deepcopy(document)
            parent(other, place)[place[-1]] = value
            yield other
        other = copy.deepcopy(document)
        del parent(other, place)[place[-1]]
        yield other
        if isinstance(parent(document, place), dict):
            other = copy.deepcopy(document)
            parent(other, place)['unheard_of'] = 1
            yield other


DOCUMENTS = {'per epoch': case_study(), 'in units': in_units(), 'mixed': {}}
DOCUMENTS['mixed'] = in_units() | {'goals': case_study(1)['goals'], 'threat': {}}
DOCUMENTS['mixed']['goals'][0]['priority_transition'] = case_study()['priority_transition']
DOCUMENTS['mixed']['threat'] = case_study()['threat']
del DOCUMENTS['mixed']['requests_per_hour']
DOCUMENTS['tasks'] = case_study(1, 2)
ORIGIN = DOCUMENTS['tasks']['grid']['origin']
DOCUMENTS['tasks']['goals'] = [
    case_study()['goals'][0] | {'task': task}
    for task in (
        {'dwell': 3.0},
        {'photo': {'count': 2, 'interval': 1.0}},
        {'external': {'timeout': 60.0}},
        {'waypoints': [[ORIGIN['latitude'], ORIGIN['longitude'], 25.0]]},
    )
]
for number, goal in enumerate(DOCUMENTS['tasks']['goals']):
    goal |= {'name': f'goal{number}', 'cell': 0}


@pytest.mark.filterwarnings('ignore:.*old word for:FutureWarning')
@pytest.mark.parametrize('name', DOCUMENTS)
def test_it_refuses_what_the_loader_refuses(name):
    counts = {True: 0, False: 0}
    for document in variants(DOCUMENTS[name]):
        accepts, problem = schema_accepts(document), refusal(document)
        counts[accepts] += 1
        if problem is None:
            assert accepts, document
        elif accepts:
            assert NOT_IN_A_SCHEMA.search(problem), problem
    assert min(counts.values()) > 100


def test_it_refuses_one_thing_in_two_ways():
    """Fields of one document in the other, where the other has them in another way."""
    refused = 0
    for one, other in ((case_study(), in_units()), (in_units(), case_study())):
        for place in places(one):
            document = copy.deepcopy(other)
            try:
                parent(document, place).setdefault(place[-1], parent(one, place)[place[-1]])
            except (KeyError, AttributeError):
                continue
            problem = refusal(document)
            assert schema_accepts(document) == (problem is None), problem
            refused += problem is not None
    assert refused > 10


def leaves(schema, path=(), said=''):
    """Every number of the schema, with what is said of it and of the fields that it is in."""
    said += schema.get('description', '')
    if schema.get('type') == 'number':
        yield path, said
    for key, below in (schema.get('properties', {}) | schema.get('patternProperties', {})).items():
        yield from leaves(below, (*path, key), said)
    if 'items' in schema:
        yield from leaves(schema['items'], path, said)


def test_every_number_has_a_unit():
    numbers = list(leaves(mission_schema()))
    assert len(numbers) > 50
    assert [path for path, said in numbers if not re.search(r'\[[^\]]+\]', said)] == []
