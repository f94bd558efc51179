"""The operator's page: what was heard, as a pure model (`heard`, `view`), and the page of it.

Nothing but `page`, `controls`, `playback_bar` and `serving` needs the extra `page`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

DEFAULT_PORT = 8080
"""TCP port of the page: what such pages usually have."""

DEFAULT_OLD_AFTER = 3.0
"""Age [s] above which what was heard is shown as old: a choice."""


def page_serving() -> Any:
    """Return the module `serving`, which takes a second to import; `ValueError` without `page`."""
    try:
        return import_module('uav_mission_manager.console.serving')
    except ModuleNotFoundError as error:
        why = f"{error.name or error}: pip install '.[page]' where this package is from"
        raise ValueError(f'the page needs {why}') from error
