"""What happens to the chain in a day: storms and calms by turns.

In a storm everything happens, at random times. In the calm after it all is put right, and what is
wanted must get done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from parts.soak.agenda import Agenda
from parts.soak.crew import NEAR, Crew
from parts.soak.day import Day
from parts.soak.mischief import Happening, Mischief
from parts.soak.whereabouts import Violated

STORM = (300.0, 900.0)
"""Shortest and longest storm [s]."""

CALM_LIMIT = 900.0
"""Time [s] of calm within which all that is wanted is done, and the vehicle is down: a choice,
three goals with a stop for a battery and one for a repair."""

STARTING_TIME = 60.0
"""Time [s] within which all processes work again."""


class Fate:
    """Lets a day pass, with a crew that looks after the vehicle.

    Parameters
    ----------
    day : Day
    without : sequence of str
        What does not happen: beginnings of names.
    """

    def __init__(self, day: Day, without: Sequence[str] = ()) -> None:
        self.day, self.rng = day, day.rng
        self.agenda = Agenda(self.rng)
        self.crew = Crew(day, self.agenda)
        self.mischief = Mischief(day, self.agenda, self.crew)
        self.happenings = [
            happening
            for happening in self.mischief.happenings()
            if not any(happening.name.startswith(name) for name in without)
        ]
        self._storm_ends = 0.0
        day.every_step = self._step

    def run(self, seconds: float, look: Callable[[float], None] = lambda now: None) -> None:
        """Let a day of this length pass: storms, and the calm after each, and a look then."""
        end = self.day.now + seconds
        while self.day.now < end:
            self.storm(min(self.rng.uniform(*STORM), end - self.day.now))
            self.calm()
            look(self.day.now)

    def storm(self, seconds: float) -> None:
        """Let things happen."""
        self.day.note('fate', 'a storm')
        self.day.counts['storms'] += 1
        self._storm_ends = self.day.now + seconds
        strength = self.rng.uniform(0.5, 2.0)
        for happening in self.happenings:
            self._next(happening, strength)
        self.day.spend(seconds)

    def calm(self) -> None:
        """Put everything right; see that all that is wanted gets done, and nothing else."""
        day, wishes = self.day, self.day.invariants.wishes
        day.note('fate', 'calm')
        self._storm_ends = 0.0
        self.agenda.finish()
        self.mischief.still()
        self.mischief.set('SIM_WIND_SPD', self.rng.uniform(0.0, 4.0))
        self.mischief.set('SIM_WIND_TURB', self.rng.uniform(0.0, 1.0))
        day.until(lambda: day.all_work, STARTING_TIME)
        if not any(wishes.wanted.values()):
            day.ask(*[self.rng.randint(1, 2) for _ in wishes.names])
        if not day.until(self._all_done, CALM_LIMIT):
            self._fail()
        day.spend(self.rng.uniform(5.0, 30.0))

    def _fail(self) -> None:
        day = self.day
        wanted = [name for name, wanted in day.invariants.wishes.wanted.items() if wanted]
        raise Violated(
            f'no goal is lost: {", ".join(wanted) or "none"} wanted, the vehicle '
            f'{"up" if day.vehicle.airborne else "down"} after {CALM_LIMIT:.0f} s of calm; '
            f'{day.invariants.command!r}; {day.diagnosis}'
        )

    def _all_done(self) -> bool:
        day, grid = self.day, self.day.mission.grid
        near = min(day.vehicle.distance(grid, cell) for cell in (grid.base, grid.service))
        wanted = any(day.invariants.wishes.wanted.values())
        return not wanted and not day.vehicle.flight.armed and near < NEAR

    def _step(self) -> None:
        self.agenda.run(self.day.now)
        self.mischief.flicker_on()
        self.crew.care()
        if not self._storm_ends:
            self._ask_again()

    def _ask_again(self) -> None:
        """Ask anew for what was out of reach in the storm, as the manager says one should."""
        day, wishes = self.day, self.day.invariants.wishes
        if any(wishes.wanted[name] for name in day.refused_goals):
            day.ask(*(int(wishes.wanted[name]) for name in wishes.names))

    def _next(self, happening: Happening, strength: float) -> None:
        def happen() -> None:
            if self.day.now >= self._storm_ends:
                return
            self.day.note('fate', happening.name)
            self.day.counts[happening.name] += 1
            happening.begin()
            self._next(happening, strength)

        due = self.day.now + self.rng.expovariate(strength / happening.period)
        if due < self._storm_ends:
            self.agenda.at(due, happen)
