"""How like two names are: what somebody meant who misspelt one."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher


def likeness(one: str, other: str) -> float:
    """Return how like two names are, 0 to 1."""
    return SequenceMatcher(None, one, other, autojunk=False).ratio()


def nearest(name: str, names: Iterable[str]) -> str:
    """Return the one of several names that is most like `name`."""
    return max(names, key=lambda other: likeness(name, other))
