"""The pages of the documentation that are made of the program leave nothing of it out."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

from uav_mission_manager import mdp

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope='module')
def generated() -> Any:
    sys.path.insert(0, str(ROOT / 'docs'))
    try:
        return import_module('generated')
    finally:
        sys.path.remove(str(ROOT / 'docs'))


def rows(page: str) -> dict[str, list[str]]:
    """Return the cells of a page's tables by the first one, which is code."""
    cells = ([c.strip() for c in line.split(' | ')] for line in page.splitlines())
    return {first.removeprefix('| `').rstrip('`'): rest for first, *rest in cells if rest}


def fields(value: Any, name: str = '') -> Iterator[str]:
    """Yield the names of all fields of a mission file; cells are values."""
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        for key, part in value.items():
            yield (inner := f'{name}.{key}'.lstrip('.') + '[]' * (key == 'goals'))
            yield from fields(part, inner)
    elif isinstance(value, list):
        for part in value:
            yield from fields(part, name)


def test_every_field_of_a_mission_file_has_a_row(generated: Any) -> None:
    table = rows(generated.schema_page())
    mission = yaml.safe_load((ROOT / 'config' / 'case_study.yaml').read_text())
    assert {'goals[].eta', 'grid.origin.latitude'} <= set(fields(mission)) <= set(table)
    assert table['grid.cell_size'][:2] == ['number >\u00a00', '`50.0`']
    assert table['goals[].cell'][:2] == ['integer ≥\u00a00, ≤\u00a0999999', 'needed']
    assert table['faults.completion'][0] == 'list of 8: number ≥\u00a00, ≤\u00a01'
    assert table['feasibility'][0] == '`strict`, `paper`'


def test_every_parameter_of_a_node_has_a_row(generated: Any) -> None:
    table = rows(generated.parameters_page())
    nodes = yaml.safe_load((ROOT / 'config' / 'nodes.yaml').read_text())
    assert {name for node in nodes.values() for name in node['ros__parameters']} <= set(table)
    assert table['priorities'][2].endswith('; *live* |')


def test_every_package_for_others_has_a_page(generated: Any) -> None:
    pages = generated.api_pages()
    assert f'{mdp.__name__}.md' in pages
    assert all(name.removesuffix('.md') in pages['api.md'] for name in pages if name != 'api.md')


def test_every_command_shows_its_help(generated: Any) -> None:
    assert '--method' in generated.help_of('cli.policy_build')
    assert {path.name for path in (ROOT / 'resource' / 'bin').iterdir()} == {
        'shim',
        *generated.commands(),
    }


@pytest.mark.parametrize('name', ['README.md', 'CONTRIBUTING.md'])
def test_links_of_a_copied_page_lead_to_the_same_file(name: str, generated: Any) -> None:
    links = [f'docs/{path.name}' for path in (ROOT / 'docs').glob('*.md')] + ['config/nodes.yaml']
    copy = generated.copied(name)
    assert '](docs/' not in copy
    assert '](config/' not in copy
    for link in links:
        if f']({link}' in (ROOT / name).read_text('utf-8'):
            shown = link.replace('docs/', '../') if 'docs/' in link else f'../../{link}'
            assert f']({shown}' in copy
            assert (ROOT / 'docs' / 'reference' / shown).resolve() == ROOT / link
