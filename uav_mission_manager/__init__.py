"""Mission decisions for a UAV from Markov decision processes solved before flight."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uav_mission_manager.mdp import load_mission
    from uav_mission_manager.policy import build_policy, load_policy, plot_policy

    __version__: str

__all__ = ['__version__', 'build_policy', 'load_mission', 'load_policy', 'plot_policy']


def __getattr__(name: str) -> Any:
    """Import what is asked for: a node watches for signals before the slow imports."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    if name == '__version__':
        return import_module(f'{__name__}.arguments').version()
    return getattr(import_module(f'{__name__}.{"mdp" if "mission" in name else "policy"}'), name)
