"""The JSON Schema of a mission file, for editors: all that one can say of a field by itself.

Run as a program it prints `config/mission.schema.json`. The loader refuses more: cells that are
not on the grid, rows that do not sum to 1, two goals of one name, whole numbers with a decimal
point, rates too high for the length of an epoch, and rates without `energy.speed`.
"""

from __future__ import annotations

import json
from typing import Any

from uav_mission_manager.mdp.fields import Check
from uav_mission_manager.mdp.mission_table import MISSION_TABLE, ONE_WAY_OF_PRIORITIES
from uav_mission_manager.mdp.tables import CELL_NUMBER, NO_DEFAULT, Cells, Entries, Field, Table

DIALECT = 'https://json-schema.org/draft/2020-12/schema'
"""Name of the edition of JSON Schema."""


def mission_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a mission file."""
    # Each goal has priorities of its own, or the mission has them.
    shared = _needed(*ONE_WAY_OF_PRIORITIES)
    own = {'properties': {'goals': {'items': shared}}}
    schema = _of_table(MISSION_TABLE, {'anyOf': [shared, own]})
    return {'$schema': DIALECT, 'title': 'Mission of uav_mission_manager', **schema}


def _of_table(table: Table, *rules: dict[str, Any]) -> dict[str, Any]:
    other_ways = {key for ways in table.alternatives for way in ways for key in way}
    needed = [row.key for row in table.rows if row.default is NO_DEFAULT]
    every = [
        *rules,
        *({'not': {'required': list(pair)}} for pair in table.exclusive()),
        *(_needed(*ways) for ways in table.alternatives if ways[0][0] in needed),
    ]
    return {
        'type': 'object',
        'properties': {row.key: _of_field(row) for row in table.rows},
        'required': [key for key in needed if key not in other_ways],
        'additionalProperties': False,
        **({'allOf': every} if every else {}),
    }


def _needed(*ways: tuple[str, ...]) -> dict[str, Any]:
    return {'anyOf': [{'required': list(way)} for way in ways]}


def _of_field(field: Field) -> dict[str, Any]:
    said: dict[str, Any] = {'description': field.text}
    if field.default is not NO_DEFAULT and field.default is not None:
        said['default'] = field.default
    return said | _of_kind(field.kind)


def _of_kind(kind: Check[Any] | Table | Cells | Entries) -> dict[str, Any]:
    if isinstance(kind, Table):
        return _of_table(kind)
    if isinstance(kind, Entries):
        return {'type': 'array', 'items': _of_table(kind.table), 'minItems': 1}
    if isinstance(kind, Cells):
        return {
            'type': 'object',
            'patternProperties': {CELL_NUMBER: dict(kind.check.schema)},
            'additionalProperties': False,
        }
    return dict(kind.schema)


if __name__ == '__main__':
    print(json.dumps(mission_schema(), indent=2))
