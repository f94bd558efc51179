"""A crew that uses a vehicle while its processes are killed: requests, holds, pilots, faults."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from parts.kills.chain import (
    ANSWER_TIME,
    GUIDED,
    KILLED,
    LAND,
    RTL,
    SERVICE_TIME,
    Chain,
)
from parts.kills.watch import EFFECT_TIME, ORDER_TIME, Watch

LIMIT = 90.0
"""Time [s] with all nodes up in which what is wanted must be done, whatever dies meanwhile: a
choice, twice what it takes undisturbed."""

WAITING_TIME = 6.0
"""Time [s] with all nodes up in which a vehicle that shall stay would take off, if it did: a
choice, more than it took in the cases that were seen."""

STILLBORN, START_TIME = 0.1, 4.0
"""Share of the nodes that are killed while they start, and within which time [s]: choices."""

STRIKES = 0.4
"""Share of the events right after which something is killed: a choice."""

STRIKE_TIME = 0.5
"""Time [s] after an event within which the kill comes: a choice."""

REPAIR_TIME = 2.0
"""Time [s] before the end of a service at which the vehicle is whole again: a choice."""

Wait = Iterator[None]
"""A part of an episode: it yields while time passes."""


class Crew:
    """Goes through episodes in random order, and kills.

    Parameters
    ----------
    chain : Chain
    watch : Watch
    chance : random.Random
    kills : int
        Of each node.
    life : float
        Mean time [s] that a node lives once it says that it is there.
    episodes : sequence of str
        Names in `EPISODES`; all by default.
    forgetful : str or None
        A node that loses what it wrote with each kill, to see that the watch notices.
    """

    def __init__(
        self,
        chain: Chain,
        watch: Watch,
        chance: random.Random,
        kills: int,
        life: float,
        forgetful: str | None = None,
        episodes: Sequence[str] = (),
    ) -> None:
        self.chain, self.watch, self._chance = chain, watch, chance
        self._life, self._forgetful = life, forgetful
        self._left = dict.fromkeys(KILLED, kills)
        self._due = dict.fromkeys(KILLED, math.inf)
        self._seen = (watch.counts['goals done'], watch.command, chain.armed)
        self._names = list(episodes or EPISODES)
        self._day = self._episodes()
        self._last, self._whole = watch.now, 0.0  # time [s] with all nodes up
        self._elsewhere_at = watch.now  # when it was last not on its way to a goal
        self.over = False

    def step(self) -> None:
        """Let time pass."""
        now = self.watch.now
        self._whole += (now - self._last) * all(self.chain.up.values())
        self._last = now
        self.chain.step(now)
        self.watch.step()
        seen = (self.watch.counts['goals done'], self.watch.command, self.chain.armed)
        if seen != self._seen:
            self._seen = seen
            self._strike(self._chance.choice(KILLED))
        for name, due in self._due.items():
            if due == math.inf and self.chain.up[name]:
                self._due[name] = now + self._chance.uniform(0.0, 2.0 * self._life)
            elif self._left[name] and now >= due:
                self._kill(name)
        if next(self._day, self) is self:
            self.over = True

    def _kill(self, name: str) -> None:
        self._left[name] = max(self._left[name] - 1, 0)
        self.chain.kill(name, forget=name == self._forgetful)
        self.watch.killed(name)
        self.watch.tell(f'{name} killed')
        self.chain.start(name)
        self._due[name] = math.inf
        if self._chance.random() < STILLBORN:
            self._due[name] = self.watch.now + self._chance.uniform(0.0, START_TIME)

    def _strike(self, name: str, certain: bool = False) -> None:
        """Have a node die soon, for what has just happened is what it may forget."""
        if certain or self._chance.random() < STRIKES:
            self._due[name] = self.watch.now + self._chance.uniform(0.0, STRIKE_TIME)

    # Episodes

    def _episodes(self) -> Wait:
        yield from self._until(lambda: self.chain.mode != -1, 'the vehicle')
        while any(self._left.values()):
            for name in self._chance.sample(self._names, len(self._names)):
                if any(self._left.values()):
                    self.watch.tell(name)
                    yield from EPISODES[name](self)

    def _mission(self) -> Wait:
        """Goals asked for are done, with threats now and then."""
        yield from self._ask(self._some_goals())
        self.chain.threat = self._chance.choice(('none', 'low', 'high'))
        yield from self._pass(self._chance.uniform(0.0, 10.0))
        self.chain.threat = 'none'
        yield from self._done()

    def _cancel(self) -> Wait:
        """What is cancelled is not flown for; a vehicle on the ground stays there."""
        yield from self._ask(self._some_goals())
        yield from self._pass(self._chance.uniform(0.0, 10.0))
        yield from self._ask((0,) * self.chain.mission.k)
        yield from self._stay()
        yield from self._ask(self._some_goals())
        yield from self._done()

    def _cancel_unheard(self) -> Wait:
        """What is cancelled while the manager is dead is not flown for."""
        yield from self._until(lambda: not self.chain.armed, 'landed')
        yield from self._bridge('hold')
        self.watch.hold()
        yield from self._ask(self._some_goals())
        yield from self._pass(EFFECT_TIME)
        self._kill('manager')
        yield from self._ask((0,) * self.chain.mission.k)
        yield from self._resume()
        yield from self._stay()

    def _hold(self) -> Wait:
        """A vehicle that was told to hold does, on the ground and aloft."""
        yield from self._ask(self._some_goals())
        yield from self._pass(self._chance.uniform(0.0, 10.0))
        yield from self._bridge('hold')
        self.watch.hold()
        self._strike('mavlink_bridge', certain=True)
        yield from self._stay()
        yield from self._resume()
        yield from self._done()

    def _pilot(self, mode: int) -> Wait:
        """A pilot lands it, here or at home; then it stays there."""
        yield from self._aloft()
        self.chain.set_mode(mode)
        yield from self._until(lambda: self.chain.mode == mode, f'mode {mode}')
        self.watch.taken = True
        self.watch.counts['pilots'] += 1
        self._strike('mavlink_bridge', certain=True)
        yield from self._until(lambda: not self.chain.armed, 'landed by the pilot')
        self._strike('mavlink_bridge', certain=True)
        yield from self._stay()
        yield from self._resume()
        yield from self._done()

    def _break(self, part: str, parameter: str, broken: float, whole: float) -> Wait:
        """What breaks in flight is repaired at the service cell, before the next flight."""
        yield from self._aloft()
        self.chain.simulate('SIM_ENGINE_FAIL', 1.0)  # which motor SIM_ENGINE_MUL is about
        self.chain.simulate(parameter, broken)
        self.watch.counts[f'broken: {part}'] += 1
        yield from self._until(lambda: self.watch.fault != 'nominal', f'{part} found broken')
        self.watch.broken = part
        yield from self._until(lambda: not self.chain.armed, 'landed for a repair')
        self._strike('mavlink_bridge', certain=True)
        yield from self._pass(SERVICE_TIME - REPAIR_TIME)
        self.watch.broken = ''
        self.chain.simulate(parameter, whole)
        yield from self._until(lambda: self.watch.fault == 'nominal', f'{part} repaired')
        yield from self._done()

    def _aloft(self) -> Wait:
        """Ask for all goals, and wait until the vehicle is on its way to one."""
        yield from self._ask(self._some_goals(least=2))
        yield from self._until(self._under_way, 'on the way to a goal')

    def _under_way(self) -> bool:
        """Whether it flies to a goal, and has done so until an order for LAND would have shown.

        A pilot's LAND would not show in one from here.
        """
        guided = self.chain.mode == GUIDED
        if not (self.chain.aloft and guided and 'commit' in self.watch.command):
            self._elsewhere_at = self.watch.now
        return self.watch.now - self._elsewhere_at > ORDER_TIME

    def _some_goals(self, least: int = 1) -> tuple[int, ...]:
        while True:
            values = tuple(self._chance.choice((0, 1, 2)) for _ in self.watch.goals)
            if sum(value > 0 for value in values) >= least:
                return values

    # What episodes are made of

    def _ask(self, values: tuple[int, ...]) -> Wait:
        """Ask for goals until that is answered."""
        self.watch.tell(f'asks for {values}')
        label = self.watch.request
        self.watch.begin(values)

        def ask() -> Any:
            self.watch.requests += 1
            return self.chain.ask_priorities(values)

        yield from self._answered(ask, lambda r: r.results[0].successful)
        self._strike('base_station')
        self._strike('manager')
        yield from self._until(lambda: self.watch.request != label, 'the request')
        self.watch.asking = False

    def _resume(self) -> Wait:
        self.watch.resuming = True
        yield from self._bridge('resume')
        self.watch.held = self.watch.taken = self.watch.resuming = False

    def _bridge(self, service: str) -> Wait:
        yield from self._answered(lambda: self.chain.ask_bridge(service), lambda r: r.success)
        self.watch.tell(f'{service} answered')

    def _answered(self, ask: Callable[[], Any], good: Callable[[Any], bool]) -> Wait:
        end = self._whole + LIMIT
        while self._whole < end:
            future, until = ask(), self.watch.now + ANSWER_TIME
            while not future.done() and self.watch.now < until:
                yield
            if future.done() and good(future.result()):
                return
            yield
        self.watch.violate('a service does not answer')

    def _done(self) -> Wait:
        yield from self._until(lambda: not any(self.watch.wanted), 'goals done')
        yield from self._pass(EFFECT_TIME)  # Else a goal done may pass for one asked for anew.

    def _until(self, condition: Callable[[], bool], what: str) -> Wait:
        end = self._whole + LIMIT
        while not condition():
            if self._whole > end:
                self.watch.violate(
                    f'{what}: not within {LIMIT:g} s; wanted {self.watch.wanted}, the manager '
                    f'knows {self.watch.states} and commands {self.watch.command!r}'
                )
                return
            yield

    def _stay(self) -> Wait:
        """Let so much time pass that a vehicle would take off, if it did."""
        end = self._whole + WAITING_TIME
        while self._whole < end:
            yield

    def _pass(self, seconds: float) -> Wait:
        end = self.watch.now + seconds
        while self.watch.now < end:
            yield


EPISODES: dict[str, Callable[[Crew], Wait]] = {
    'mission': Crew._mission,
    'cancelled': Crew._cancel,
    'cancelled unheard': Crew._cancel_unheard,
    'held': Crew._hold,
    'pilot lands': lambda crew: crew._pilot(LAND),
    'pilot returns': lambda crew: crew._pilot(RTL),
    'broken motor': lambda crew: crew._break('motor', 'SIM_ENGINE_MUL', 0.7, 1.0),
    'dead camera': lambda crew: crew._break('camera', 'SIM_CAM_FAIL', 1.0, 0.0),
}
"""What happens to a vehicle, by name."""
