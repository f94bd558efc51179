"""Checkpoints of long solves: one file beside the policy set to be, for this mission only."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy.store import PolicyError

INTERVAL = 60.0
"""Seconds between checkpoints: shorter solves leave none."""


class Checkpoint:
    """Word of how far a solve has come.

    Parameters
    ----------
    directory : path
        The policy set to be; the file lies beside it.
    mission : Mission
    method, precision : str
        A checkpoint of another mission, method or precision is refused.
    interval : float
        Seconds between two checkpoints.
    """

    def __init__(
        self,
        directory: str | Path,
        mission: Mission,
        method: str,
        precision: str,
        interval: float = INTERVAL,
    ) -> None:
        place = Path(directory).resolve()
        self.file = place.with_name(f'.{place.name}.checkpoint.npz')
        self.key = f'{mission.digest()} {method} {precision}'
        self.interval, self.last = interval, time.monotonic()

    def load(self, position: int) -> tuple[int, NDArray[Any]] | None:
        """Return sweeps and W of a sub-MDP where the file holds that; else None.

        Raises
        ------
        PolicyError
            If it cannot be read, or is of another mission, method or precision.
        """
        if not self.file.exists():
            return None
        try:
            with np.load(self.file, allow_pickle=False) as content:
                key, *progress = (content[name] for name in ('key', 'position', 'sweeps'))
                values = content['values']
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            raise PolicyError(f'{self.file}: cannot be read: {error}') from error
        if str(key) != self.key:
            raise PolicyError(
                f'{self.file}: key: is of another mission, method or precision; delete it'
            )
        reached, sweeps = map(int, progress)
        return (sweeps, values) if reached == position else None

    def save(self, position: int, sweeps: int, values: NDArray[Any]) -> None:
        """Write the file if it is time. Raises `PolicyError`."""
        if time.monotonic() - self.last < self.interval:
            return
        fresh = self.file.with_name(self.file.name + '.tmp')
        try:
            fresh.parent.mkdir(parents=True, exist_ok=True)
            with fresh.open('wb') as stream:
                np.savez(stream, key=self.key, position=position, sweeps=sweeps, values=values)
            fresh.replace(self.file)
        except OSError as error:
            raise PolicyError(f'{self.file}: cannot be written: {error}') from error
        finally:
            fresh.unlink(missing_ok=True)
        self.last = time.monotonic()

    def remove(self) -> None:
        """Delete the file, the solve being done."""
        self.file.unlink(missing_ok=True)
