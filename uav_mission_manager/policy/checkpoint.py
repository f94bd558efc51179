"""Checkpoints of long solves: one file beside the policy set to be, for this mission only."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from uav_mission_manager.echo import shown, why_not
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.arrays import RealArray
from uav_mission_manager.policy.store import MANIFEST_SCHEMA, PolicyError

CHECKPOINT_INTERVAL = 60.0
"""Time [s] between two checkpoints: a choice; a solve that is shorter leaves none."""


class Checkpoint:
    """A file with W and the number of sweeps so far, from which a solve can be resumed.

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
        interval: float = CHECKPOINT_INTERVAL,
    ) -> None:
        place = Path(directory).resolve()
        self.file = place.with_name(f'.{place.name}.checkpoint.npz')
        self.key = f'{MANIFEST_SCHEMA} {mission.digest()} {method} {precision}'
        self.interval, self.last = interval, time.monotonic()

    def load(self) -> tuple[int, RealArray] | None:
        """Return sweeps and W where there is a file; else None.

        Raises
        ------
        PolicyError
            If it cannot be read, or is of another mission, method or precision.
        """
        if not self.file.exists():
            return None
        try:
            with np.load(self.file, allow_pickle=False) as content:
                key, sweeps, values = (content[name] for name in ('key', 'sweeps', 'values'))
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            raise PolicyError(f'{shown(self.file)}: cannot be read: {why_not(error)}') from error
        if str(key) != self.key:
            raise PolicyError(
                f'{shown(self.file)}: key: is of another mission, method or precision; delete it'
            )
        return int(sweeps), values

    def save(self, sweeps: int, values: Callable[[], RealArray]) -> None:
        """Write the file if it is time, with the W that `values` returns. Raises `PolicyError`."""
        if time.monotonic() - self.last < self.interval:
            return
        fresh = self.file.with_name(self.file.name + '.tmp')
        try:
            fresh.parent.mkdir(parents=True, exist_ok=True)
            with fresh.open('wb') as stream:
                np.savez(stream, key=self.key, sweeps=sweeps, values=values())
            fresh.replace(self.file)
        except OSError as error:
            raise PolicyError(
                f'{shown(self.file)}: cannot be written: {why_not(error)}'
            ) from error
        finally:
            fresh.unlink(missing_ok=True)
        self.last = time.monotonic()

    def remove(self) -> None:
        """Delete the file, the solve being done."""
        self.file.unlink(missing_ok=True)
