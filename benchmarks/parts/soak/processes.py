"""What is common to the processes: clocks, journals, topics, and how they die.

A process has a clock of its own for time-outs, which begins anywhere, and one for stamps, which
may be wrong.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from parts.soak.wires import Topic
from uav_mission_manager.mdp import Mission
from uav_mission_manager.onboard.journal import Journal, JournalError, goals_hash

LISTENING_TIME = 3.0
"""Time [s] in which a process that has started only listens: the nodes' default."""

LOSS = 0.02
"""Share of messages lost where their quality of service allows it: a choice."""

MAX_CLOCK = 1e6
"""Latest beginning [s] of a process' clock for time-outs: a computer that has been up for days."""


class Killed(BaseException):  # So that nobody in between catches it.
    """The process has died in the middle of what it did."""


class Watch(Protocol):
    """What is told to those who watch the chain from outside."""

    counts: Counter[str]

    def heard(self, message: Any) -> None:
        """The bridge has read a message of the autopilot."""

    def sent(self, message: Any) -> None:
        """The bridge has sent a message."""

    def commanded(self, text: str) -> None:
        """The manager has published a command."""

    def completed(self, goal: str) -> None:
        """The bridge has published that a goal is completed."""

    def refused(self, goal: str) -> None:
        """The bridge has published that a goal is out of reach."""

    def note(self, who: str, text: str) -> None:
        """Someone has something to tell."""


class Bus:
    """All topics."""

    def __init__(self, rng: random.Random) -> None:
        def lossy() -> Topic:
            return Topic(rng, LOSS)

        def event() -> Topic:
            return Topic(rng, depth=10)

        def latched() -> Topic:
            return Topic(rng, depth=1, latched=True)

        self.battery, self.odom, self.fault, self.threat = lossy(), lossy(), lossy(), lossy()
        self.priorities = Topic(rng, LOSS, depth=1)
        self.completed, self.refused, self.to_station = event(), event(), event()
        self.to_bridge, self.failed = event(), event()
        self.command, self.goals, self.policy = latched(), latched(), latched()

    def complete(self, goal: str, now: float) -> None:
        """Tell everybody that a goal is completed."""
        for topic in (self.completed, self.to_station, self.to_bridge):
            topic.publish(goal, now)


class Process:
    """One process; it is `up` from `start` until `kill`.

    Attributes
    ----------
    stalled_until, worked_at : float
        Time [s] until which it stands still, and of its last step.
    wall_error : float
        How far [s] its clock for stamps is ahead.
    dies_at : str
        Where in its next step it dies: 'before memory', 'after memory', 'sending' or ''.
    doubt : str
        Why it could not believe its journal when it started, '' if it could.
    forgetful : bool
        Whether it does not believe its journal: a fault to show that it would be noticed.
    """

    name = ''
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()

    def __init__(
        self, mission: Mission, bus: Bus, watch: Watch, folder: Path, rng: random.Random
    ) -> None:
        self.mission, self._mission_hash = mission, goals_hash(mission)
        self.bus, self.watch, self.folder, self.rng = bus, watch, folder, rng
        self.up, self.forgetful, self.dies_at, self.doubt = False, False, '', ''
        self.stalled_until = self.wall_error = 0.0
        self.started_at = self.worked_at = 0.0
        self.starts = 0
        self._epoch = 0.0
        self.now = 0.0

    def start(self, now: float, *, computer_too: bool = False) -> None:
        """Begin as a new process does: with the journal, and nothing else."""
        self.now = self.started_at = self.worked_at = now
        if self.starts == 0 or computer_too:
            self._epoch = self.rng.choice((100.0, MAX_CLOCK)) * self.rng.random() - now
        for topic in self.reads:
            getattr(self.bus, topic).reader_starts(now)
        self.begin()
        self.up, self.dies_at, self.stalled_until = True, '', 0.0
        self.starts += 1

    def kill(self) -> None:
        """Die without a word."""
        self.up, self.dies_at = False, ''
        for topic in self.writes:
            getattr(self.bus, topic).writer_dies()
        self.end()

    def step(self, now: float) -> None:
        """Go on to `now`, or die on the way."""
        self.now = now
        if not self.up or now < self.stalled_until:
            return
        try:
            self.work()
            self.worked_at = now
            if self.dies_at:
                raise Killed
        except Killed:
            self.kill()

    @property
    def clock(self) -> float:
        """The time [s] for time-outs."""
        return self.now + self._epoch

    @property
    def wall(self) -> float:
        """The time [s] for stamps."""
        return self.now + 1e9 + self.wall_error

    @property
    def works(self) -> bool:
        """Whether it does its work, and not only listens."""
        settled = self.now - self.started_at >= LISTENING_TIME
        return self.up and settled and self.now >= self.stalled_until

    def begin(self) -> None:
        """Make the core anew."""

    def end(self) -> None:
        """Let the files go, as the end of a process does."""
        self.journal.close()

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Record the core's state, before anything follows from it."""
        self.die('before memory')
        self.journal.write(memory)
        self.die('after memory')
        if self.journal.error:
            raise OSError(self.journal.error)

    def recall(self) -> Mapping[str, Any] | None:
        """Open the journal, and return what it says; None on the first start."""
        self.journal = Journal(self._journal_path, self.name, self._mission_hash)
        self.doubt = ''
        try:
            record = self.journal.read()
        except JournalError as error:
            self.doubt = str(error)
            self.watch.note(self.name, self.doubt)
            return None
        return None if record is None or self.forgetful else record.state

    def damage(self) -> None:
        """Let a bit be wrong in the last line of its journal."""
        path = self._journal_path
        content = bytearray(path.read_bytes()) if path.exists() else bytearray()
        if content:
            first = content.rfind(b'\n', 0, len(content) - 1) + 1
            content[self.rng.randrange(first, len(content))] ^= 1 << self.rng.randrange(8)
            path.write_bytes(content)

    @property
    def _journal_path(self) -> Path:
        return self.folder / f'{self.name}.journal'

    def work(self) -> None:
        """Do what is due."""

    def die(self, where: str) -> None:
        """Die here, if this is where."""
        if self.dies_at == where:
            raise Killed
