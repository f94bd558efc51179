"""The policy sets at hand, by their digest: which mission a vehicle flies, and by what values."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from uav_mission_manager.policy import Policy, load_policy
from uav_mission_manager.policy.store import read_digest

LOOK_AGAIN_PERIOD = 5.0
"""Time [s] between two looks for a set that is not at hand: a choice."""

MOST_ANNOUNCED = 8
"""Sets that vehicles announced and that are kept, at most: a choice, two of each of four."""


class PolicyShelf:
    """Policy sets of some folders; one that was written anew there is found, too.

    So is one that a vehicle's solver announced, such as that of a goal requested in flight.

    Parameters
    ----------
    paths : sequence of str
        Folders of policy sets. Raises what `load_policy` raises.
    """

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = tuple(paths)
        self._sets: dict[str, Policy] = {}
        self._announced: tuple[Policy, ...] = ()
        self._looked_at = 0.0
        self._looking = threading.Lock()
        for path in self._paths:
            self._look(path)
        self._parts = lru_cache(100)(self._part_values)

    def find(self, digest: str, now: float, announced: str = '') -> Policy | None:
        """Return the set with a digest; None while it is not at hand: it is then looked for.

        Parameters
        ----------
        digest : str
        now : float
            Time [s].
        announced : str
            Folder of the vehicle's last announced set, '' for none.
        """
        found = self._at_hand(digest)
        if found is None and digest and now - self._looked_at > LOOK_AGAIN_PERIOD:
            self._looked_at = now
            threading.Thread(
                target=self._look_again, args=(digest, announced), daemon=True
            ).start()
        return found

    def parts(
        self, policy: Policy, state: tuple[int, ...]
    ) -> tuple[tuple[tuple[int, ...], float], ...]:
        """Goals and share in the cost of each part of a set; none in a state that it has not."""
        return self._parts(policy.digest, state)

    def _part_values(
        self, digest: str, state: tuple[int, ...]
    ) -> tuple[tuple[tuple[int, ...], float], ...]:
        policy = self._at_hand(digest)
        if policy is None:
            return ()
        try:
            values = policy.part_values([state])[0].tolist()
        except ValueError:
            return ()
        return tuple(zip(policy.parts, values))

    def _at_hand(self, digest: str) -> Policy | None:
        announced = (policy for policy in self._announced if policy.digest == digest)
        return self._sets.get(digest) or next(announced, None)

    def _look(self, path: str) -> None:
        policy = load_policy(path)
        self._sets.setdefault(policy.digest, policy)  # Who shows the mission knows it by this one.

    def _look_again(self, digest: str, announced: str) -> None:
        """Read the folders anew, in a thread; one that cannot be read now may be later."""
        if not self._looking.acquire(blocking=False):
            return
        try:
            for path in self._paths:
                with suppress(ValueError, OSError, MemoryError):
                    self._look(path)
            with suppress(ValueError, OSError, MemoryError):
                if announced and read_digest(Path(announced)) == digest:
                    policy = load_policy(announced)
                    self._announced = (*self._announced, policy)[-MOST_ANNOUNCED:]
        finally:
            self._looking.release()
