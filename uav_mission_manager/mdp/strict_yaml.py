"""YAML without its silent traps: what is read is what a person means by the text."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import yaml

from uav_mission_manager.echo import quoted

_TAG = 'tag:yaml.org,2002:'
_NULL = f'{_TAG}null'
_DIGITS = '([0-9]+ | [0-9]{1,3} (_[0-9]{3})+)'
"""A whole number, its thousands apart or not."""


def read_yaml(text: str) -> Any:
    """Return what a YAML document holds.

    A key given twice is an error. What YAML 1.1 reads as a number to the base 8 or 60 (010, 1:30)
    and YAML 1.2 does not is none; 1e-3, the other way round, is one. Nor are yes and no truth
    values, 2020-01-02 a date, or << a key that merges, which versions of PyYAML do differently.
    A scalar that is not what its tag says is text.

    Raises
    ------
    yaml.YAMLError, RecursionError
        Where it is none, or nested too deeply.
    """
    return yaml.load(text, Loader=_StrictLoader)


class _StrictLoader(yaml.SafeLoader):
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in resolvers if tag == _NULL]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    yaml_constructors = {  # noqa: RUF012
        tag: yaml.SafeLoader.yaml_constructors[tag]
        for tag in (None, _NULL, *(f'{_TAG}{kind}' for kind in ('str', 'seq', 'map')))
    }

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Compose a mapping of which no key is given twice, however it is written."""
        node = super().compose_mapping_node(anchor)
        keys = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode):
                key = self.construct_object(key_node)
                if key in keys:
                    place = str(node.start_mark).strip()
                    raise yaml.YAMLError(f'key {quoted(key)} twice in one mapping {place}')
                keys.add(key)
        return node


def _read_scalars(kind: str, pattern: str, read: Callable[[str], Any]) -> None:
    """Let the loader read scalars that match a pattern, with an explicit tag or without."""
    whole = re.compile(rf'(?:{pattern})\Z', re.VERBOSE)

    def construct(loader: _StrictLoader, node: yaml.ScalarNode) -> Any:
        text = loader.construct_scalar(node)
        try:
            return read(text.replace('_', '').lower()) if whole.match(text) else text
        except ValueError:  # Of too many digits.
            return text

    _StrictLoader.add_constructor(f'{_TAG}{kind}', construct)
    _StrictLoader.add_implicit_resolver(f'{_TAG}{kind}', whole, [*'-+.0123456789tTfF'])


def _float(text: str) -> float:
    value = float(re.sub(r'\.(?=inf|nan)', '', text))
    if value == 0 and re.match('[^e]*[1-9]', text):
        raise ValueError('too close to 0')
    return value


_read_scalars('bool', 'true|True|TRUE|false|False|FALSE', 'true'.__eq__)
_read_scalars(
    'int',
    r'[-+]? (0 | (?!0) DIGITS | 0b [01]+ | 0x [0-9a-fA-F]+)'.replace('DIGITS', _DIGITS),
    lambda text: int(text, 0),
)
_read_scalars(
    'float',
    r"""[-+]? (
        (DIGITS \. [0-9]* | \. [0-9]+) ([eE] [-+]? [0-9]+)?
        | DIGITS [eE] [-+]? [0-9]+
        | \. (inf | Inf | INF | nan | NaN | NAN)
    )""".replace('DIGITS', _DIGITS),
    _float,
)
