"""The policy sets at hand, by their digest: which mission a vehicle flies, and by what values."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import lru_cache

from uav_mission_manager.policy import Policy, load_policy

LOOK_AGAIN_PERIOD = 5.0
"""Time [s] between two looks for a set that is not at hand: a choice."""


class PolicyShelf:
    """Policy sets of some folders; one that was written anew there is found, too.

    Parameters
    ----------
    paths : sequence of str
        Folders of policy sets. Raises what `load_policy` raises.
    """

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = tuple(paths)
        self._sets: dict[str, Policy] = {}
        self._looked_at = 0.0
        self._looking = threading.Lock()
        self._look()
        self._parts = lru_cache(100)(self._part_values)

    def find(self, digest: str, now: float) -> Policy | None:
        """Return the set with a digest; None while it is not at hand: it is then looked for."""
        found = self._sets.get(digest)
        if found is None and digest and now - self._looked_at > LOOK_AGAIN_PERIOD:
            self._looked_at = now
            threading.Thread(target=self._look_again, daemon=True).start()
        return found

    def parts(
        self, policy: Policy, state: tuple[int, ...]
    ) -> tuple[tuple[tuple[int, ...], float], ...]:
        """Goals and share in the cost of each part of a set; none in a state that it has not."""
        return self._parts(policy.digest, state)

    def _part_values(
        self, digest: str, state: tuple[int, ...]
    ) -> tuple[tuple[tuple[int, ...], float], ...]:
        policy = self._sets[digest]
        try:
            values = policy.part_values([state])[0].tolist()
        except ValueError:
            return ()
        return tuple(zip(policy.parts, values))

    def _look(self) -> None:
        for path in self._paths:
            policy = load_policy(path)
            self._sets[policy.digest] = policy

    def _look_again(self) -> None:
        """Read the folders anew, in a thread; one that cannot be read now may be later."""
        if not self._looking.acquire(blocking=False):
            return
        try:
            self._look()
        except (ValueError, OSError, MemoryError):
            pass
        finally:
            self._looking.release()
