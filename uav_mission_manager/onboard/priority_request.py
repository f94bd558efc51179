"""The base station's request for goal priorities, through the lives of several processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

REQUEST_TIME = 4.0
"""Time [s] after listening in which a manager that goes on as before waits to hear what is wanted
by now: the longest discovery that was measured, 2.6 s, a repetition of the base station, and a
little more."""


class PriorityRequest:
    """What is asked for: one request, repeated until another one takes its place.

    Parameters
    ----------
    goals : sequence of str
        Names in the mission file's order.
    memory : mapping, optional
        `memory` of the one to go on with.

    Attributes
    ----------
    request : str
        Its id; empty until something is asked for.
    asked : tuple of int
        Priority of each goal as asked for: 0 none, 1 low, 2 high. Goals that were added in flight
        may be left out.
    """

    def __init__(self, goals: Sequence[str], memory: Mapping[str, Any] | None = None) -> None:
        self._goals, self._least = tuple(goals), len(goals)
        self.request, self.asked = '', (0,) * len(self._goals)
        self._achieved: set[str] = set()
        self._given = self.asked
        if memory is not None:
            self._goals = tuple(memory.get('goals', goals))
            self.ask(memory['asked'], memory['request'])
            self._given = tuple(memory['given'])
            for name in memory['achieved']:
                self.complete(name)

    @property
    def memory(self) -> dict[str, Any]:
        """What the next process needs to go on, as JSON values."""
        return {
            'request': self.request,
            'asked': list(self.asked),
            'achieved': self.achieved,
            'given': list(self._given),
            'goals': list(self._goals),
        }

    @property
    def achieved(self) -> list[str]:
        """Names of the goals that were asked for and have been completed since."""
        return sorted(self._achieved)

    @property
    def priorities(self) -> tuple[int, ...]:
        """What is repeated: as asked for, an achieved goal at 0 lest anyone revives it."""
        pairs = zip(self._goals, self.asked)
        return tuple(0 if name in self._achieved else value for name, value in pairs)

    def learn(self, goals: Sequence[str]) -> None:
        """Take note of the goals that the vehicle has by now, some of them requested in flight.

        What was asked of a goal that is no more is not asked of the one in its place.
        """
        if len(goals) >= self._least:
            kept = zip(self._goals, goals, self.asked)
            self.asked = tuple(value if was == now else 0 for was, now, value in kept)
            self._goals = tuple(goals)

    def begin(self, values: Sequence[int], request: str) -> bool:
        """Start a process that was given these priorities; return whether they are a new request.

        They are none if they are all 0, or asked for already, or what the process before was
        given too: whatever was asked for since then, by a person, is not undone by a restart.
        """
        if fault := self.fault_in(values):
            raise ValueError(fault)
        before, self._given = self._given, tuple(values)
        if not any(values) or self._given in (self.asked, before):
            return False
        self.ask(values, request)
        return True

    def ask(self, values: Sequence[int], request: str) -> None:
        """Make a new request with an id that no other has. Raises ValueError, see `fault_in`."""
        if fault := self.fault_in(values):
            raise ValueError(fault)
        self.request, self.asked, self._achieved = request, tuple(values), set()

    def complete(self, name: str) -> bool:
        """Take a goal as achieved; return whether that is new."""
        wanted = dict(zip(self._goals, self.priorities)).get(name, 0) > 0
        if wanted:
            self._achieved.add(name)
        return wanted

    def fault_in(self, values: Sequence[int]) -> str:
        """Say why these cannot be asked for; empty if they can."""
        if not self._least <= len(values) <= len(self._goals):
            added = len(self._goals) - self._least
            return (
                f'{len(values)} values, the mission has {len(self._goals)} goals '
                f'({", ".join(self._goals)}){f", {added} of them added in flight" * bool(added)}'
            )
        for goal, value in zip(self._goals, values):
            if value not in (0, 1, 2):
                return f'{goal} is {value}, not 0, 1 or 2'
        return ''
