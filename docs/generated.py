"""The pages of the site that are made of the program itself, into `reference/`."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

from uav_mission_manager.mdp.mission_schema import mission_schema
from uav_mission_manager.nodes.ending import NODES
from uav_mission_manager.nodes.parameters import NodeParameter
from uav_mission_manager.nodes.priority_parameter import REQUESTED_PRIORITIES

ROOT = Path(__file__).parents[1]
PACKAGE = 'uav_mission_manager'

COPIES = ('README.md', 'CONTRIBUTING.md', 'CHANGELOG.rst')
"""Pages of the repository's root that the site has too."""

LIMITS = {'minimum': '≥', 'exclusiveMinimum': '>', 'maximum': '≤', 'exclusiveMaximum': '<'}
"""Signs of what JSON Schema calls so."""

HELP_COLUMNS = '92'
"""Width of the commands' help: a choice, what fits beside the contents."""


def write(docs: Path) -> None:
    """Write every generated page that is not there as it should be, and delete all others.

    Parameters
    ----------
    docs : path
        The folder of the site's pages.
    """
    folder = docs / 'reference'
    folder.mkdir(exist_ok=True)
    made = {
        **{name: copied(name) for name in COPIES},
        **api_pages(),
        'commands.md': commands_page(),
        'parameters.md': parameters_page(),
        'mission_schema.md': schema_page(),
    }
    for path in folder.iterdir():
        if path.name not in made:
            path.unlink()
    for name, text in made.items():
        path = folder / name
        if not path.exists() or path.read_text('utf-8') != text:
            path.write_text(text, 'utf-8')


def copied(name: str) -> str:
    """Return a page of the root with its links as seen from `reference/`."""
    text = (ROOT / name).read_text('utf-8')
    text = text.replace('](docs/', '](../')
    return re.sub(r'\]\((config|LICENSE|CITATION)', r'](../../\1', text)


def api_pages() -> dict[str, str]:
    """Return a page for each package that has `__all__`, for others to use, and one of all."""
    pages = {}
    for path in sorted((ROOT / PACKAGE).glob('*/**/__init__.py')):
        if '__all__' in path.read_text('utf-8'):
            name = '.'.join(path.parent.relative_to(ROOT).parts)
            directive = f'```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n```'
            pages[name] = f'# {name.removeprefix(f"{PACKAGE}.")}\n\n{directive}\n'
    contents = '\n'.join(pages)
    head = (
        '# Python\n\nWhat each package has for others to use. `build_policy`, `load_mission` and '
        f'`load_policy` can be imported from `{PACKAGE}` itself.\n'
    )
    pages['api'] = f'{head}\n```{{toctree}}\n:maxdepth: 1\n\n{contents}\n```\n'
    return {f'{name}.md': text for name, text in pages.items()}


def commands() -> dict[str, str]:
    """Return the module of each command, as setup.py has them."""
    text = (ROOT / 'setup.py').read_text('utf-8')
    return ast.literal_eval(re.search(r'^COMMANDS = (\{.*?^\})', text, re.M | re.S)[1])


def commands_page() -> str:
    """Return what each command's `--help` prints."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        helps = list(pool.map(help_of, commands().values()))
    parts = [
        f'## {name}\n\n```text\n{text}```\n' for name, text in zip(commands(), helps, strict=True)
    ]
    return '\n'.join(['# Commands\n\nWhat `NAME --help` prints of each.\n', *parts])


def help_of(module: str) -> str:
    """Return what `--help` of a module of this package prints."""
    run = subprocess.run(
        [sys.executable, '-m', f'{PACKAGE}.{module}', '--help'],
        env=os.environ | {'COLUMNS': HELP_COLUMNS},
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout


def parameters_page() -> str:
    """Return the parameters of each node as tables."""
    parts = [
        '# Node parameters\n\nGive them by `--ros-args -p NAME:=VALUE` or in a params file. Those '
        'that can be set while the node runs say *live*.\n'
    ]
    for name in NODES:
        table = import_module(f'{PACKAGE}.nodes.{name}').PARAMETERS
        if name in ('base_station', 'fleet'):
            table = (*table, REQUESTED_PRIORITIES)
        parts += [
            f'## {name}\n',
            *_table(('parameter', 'default', 'range', 'meaning'), map(_parameter, table)),
        ]
    return '\n'.join(parts)


def _parameter(row: NodeParameter) -> tuple[str, ...]:
    limits = '' if row.minimum is None else f'{row.minimum:g} to {row.maximum:g}'
    default = 'needed' if row.example else f'`{json.dumps(row.default)}`'
    return (
        f'`{row.name}`',
        default,
        limits,
        row.description + ('' if row.read_only else '; *live*'),
    )


def schema_page() -> str:
    """Return the fields of a mission file as a table, from its JSON Schema."""
    head = (
        '# Mission file fields\n\nWhat `config/mission.schema.json` says of each field. '
        '[The mission file](../mission_file.md) says how to come by the numbers.\n'
    )
    rows = _fields(mission_schema(), '')
    return '\n'.join([head, *_table(('field', 'value', 'default', 'meaning'), rows)])


def _fields(schema: dict[str, Any], prefix: str) -> Iterator[tuple[str, ...]]:
    for key, field in schema['properties'].items():
        name, inner = f'{prefix}{key}', field
        if field.get('type') == 'array' and 'properties' in field['items']:
            name, inner = f'{name}[]', field['items']
        default = f'`{field["default"]}`' if 'default' in field else ''
        if key in schema['required']:
            default = 'needed'
        yield f'`{name}`', _value(field), default, field['description']
        if 'properties' in inner:
            yield from _fields(inner, f'{name}.')


def _value(field: dict[str, Any]) -> str:
    """Return in words what values a schema lets through."""
    kind = field.get('type')
    if 'enum' in field or 'const' in field:
        return ', '.join(f'`{value}`' for value in field.get('enum', [field.get('const')]))
    if 'anyOf' in field:
        return ' or '.join(_value(way) for way in field['anyOf'] if not way.get('deprecated'))
    if kind == 'array':
        fixed = field['minItems'] == field.get('maxItems')
        each = _value(field['items'] if 'items' in field else field['prefixItems'][0])
        return f'list of {field["minItems"]}: {each}' if fixed else f'list: {each}'
    if kind == 'object':
        by_cell = [_value(each) for each in field.get('patternProperties', {}).values()]
        return f'by cell: {by_cell[0]}' if by_cell else 'mapping'
    limits = [f'{sign}\u00a0{field[key]:.10g}' for key, sign in LIMITS.items() if key in field]
    return f'{kind} {", ".join(limits)}'.strip()


def _table(head: tuple[str, ...], rows: Any) -> Iterator[str]:
    yield from (f'| {" | ".join(cells)} |' for cells in (head, ('---',) * len(head)))
    for row in rows:
        yield f'| {" | ".join(cell.replace("|", chr(92) + "|") for cell in row)} |'
    yield ''
