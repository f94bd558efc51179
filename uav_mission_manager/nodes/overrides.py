"""Parameters given to a node that it does not have: misspelt, or meant for another node."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter

from uav_mission_manager.likeness import likeness, nearest

QOS_PREFIX = 'qos_overrides.'
"""What names of parameters for the quality of service begin with; topics declare them."""

MISSPELT = 0.85
"""Likeness of two names above which one is taken for a misspelling of the other: a choice; `polcy`
and `policy` have 0.91, any two parameters of different nodes of this package 0.8 at most."""


def refuse_unknown(node: Node, known: Iterable[str] = (), *, qos: bool = False) -> None:
    """Refuse parameters given to `node` that it has not declared, `known` aside.

    A params file may serve several nodes. What it gives to all of them, by a `*` or `**` in
    the place of the node's name, is ignored with a warning, unless it looks like a misspelling.

    Parameters
    ----------
    node : Node
    known : iterable of str
        Names that will be declared.
    qos : bool
        Whether to look at quality of service only, which is declared with the topics; else at
        all the rest.

    Raises
    ------
    ValueError
        One line with the parameter and the nearest one that there is.
    """
    names = {*known, *node.get_parameters_by_prefix('')}
    given = set(node.handle.get_parameters(Parameter))
    unknown = sorted(n for n in given - names if n.startswith(QOS_PREFIX) == qos)
    for_all = given_to_all(sys.argv) if unknown else set()
    for name in unknown:
        meant = nearest(name, names)
        if name not in for_all or likeness(name, meant) > MISSPELT:
            raise ValueError(
                f'parameter {name}: {node.get_name()} has none of this name; '
                f'the nearest is {meant}'
            )
    if unknown:
        node.get_logger().warning(
            f'ignored, as given to all nodes and unknown to this one: {", ".join(unknown)}',
            once=True,
        )


def given_to_all(arguments: list[str]) -> set[str]:
    """Return the parameters that files give to every node, without those given by `-p`."""
    files = [value for option, value in pairwise(arguments) if option == '--params-file']
    single = {
        value.partition(':=')[0]
        for option, value in pairwise(arguments)
        if option in ('-p', '--param')
    }
    return {name for file in files for name in _for_all(file)} - single


def _for_all(file: str) -> Iterator[str]:
    try:
        tree = yaml.safe_load(Path(file).read_text(encoding='utf-8'))
    except (OSError, ValueError, yaml.YAMLError):
        return  # ROS has read it, and says what is wrong with it.
    yield from _walk(tree, '')


def _walk(tree: Any, node: str) -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key != 'ros__parameters':
                yield from _walk(value, str(key))
            elif node.rpartition('/')[2] in ('*', '**'):
                yield from _names(value, '')


def _names(tree: Any, prefix: str) -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _names(value, f'{prefix}.{key}' if prefix else str(key))
    else:
        yield prefix
