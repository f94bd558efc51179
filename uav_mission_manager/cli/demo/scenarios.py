"""What happens in the demo, as scripts: each yields the condition it waits for next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from uav_mission_manager.cli.demo.flight import DemoFlight

Wait = tuple[str, Callable[[], bool]]
"""What is waited for, in words and as a test."""

WEAK_MOTOR_THRUST = 0.75
"""Thrust left of the motor that weakens (fraction): a choice, enough to fly, found as a fault."""

LOW_CHARGE = 21.0
"""Charge [%] for 119 m: a choice; most goals are out of range, the service cell is not."""


def case_one(flight: DemoFlight) -> Iterator[Wait]:
    """The paper's Case I: a goal is raised, reached, completed; a threat on the way home."""
    (goal,) = flight.mission.goals
    flight.ask()  # The manager decides nothing before it is told what is wanted.
    yield 'the vehicle ready at the base', lambda: flight.command == 'none normal' and flight.home
    flight.ask(**{goal.name: 2})
    yield 'the commitment', lambda: flight.command.startswith(f'commit {goal.name}')
    yield 'the goal completed', lambda: goal.name in flight.completed
    yield 'the way home', lambda: flight.command == 'none normal'
    flight.meet('high')
    yield 'agile flight', lambda: flight.command == 'none agile'
    yield 'the base', lambda: flight.cell == flight.mission.grid.base
    flight.meet('none')
    yield 'normal flight', lambda: flight.command == 'none normal'
    yield 'the vehicle home and disarmed', lambda: flight.home


def three_goals(flight: DemoFlight) -> Iterator[Wait]:
    """Priorities change, a threat appears, a motor weakens, the battery runs low."""
    first, second, third = (goal.name for goal in flight.mission.goals)
    threatened = flight.mission.goals[1].cell
    flight.ask()  # The manager decides nothing before it is told what is wanted.
    yield 'the vehicle ready at the base', lambda: flight.command == 'none normal' and flight.home
    flight.meet('high', cell=threatened)
    flight.ask(**{first: 1, third: 1})
    yield 'the first commitment', lambda: flight.command.startswith('commit') and flight.armed
    yield 'one goal completed', lambda: bool(flight.completed)
    left = {name: 1 for name in (first, third) if name not in flight.completed}
    flight.ask(**left, **{second: 2})
    yield f'the way to {second}', lambda: flight.command.startswith(f'commit {second}')
    yield 'agile flight under threat', lambda: flight.command == f'commit {second} agile'
    yield f'{second} completed', lambda: second in flight.completed
    flight.meet('none')
    flight.inject(
        f'motor 1 weakens to {WEAK_MOTOR_THRUST:.0%}',
        SIM_ENGINE_MUL=WEAK_MOTOR_THRUST,
        SIM_ENGINE_FAIL=1,
    )
    yield 'the fault found', lambda: flight.fault == 'actuator'
    yield 'the command to repair', lambda: flight.command == 'repair'
    yield 'the landing for repair', lambda: flight.on_ground
    flight.inject('ground crew: motor replaced', SIM_ENGINE_FAIL=0, SIM_ENGINE_MUL=1)
    yield 'the repair', lambda: flight.fault == 'nominal'
    if first in flight.completed and third in flight.completed:
        flight.ask(**{first: 2})
        flight.completed.remove(first)
    yield 'the next commitment', lambda: flight.command.startswith('commit') and flight.armed
    flight.inject(f'battery drops to {LOW_CHARGE:.0f} %', SIM_BATT_PCT=LOW_CHARGE)
    yield 'the command to recharge', lambda: flight.command == 'recharge'
    yield 'the landing to recharge', lambda: flight.on_ground
    flight.inject('ground crew: battery replaced', SIM_BATT_PCT=100)
    yield 'every goal completed', lambda: flight.asked <= set(flight.completed)
    yield 'the vehicle home and disarmed', lambda: flight.home


def own_mission(flight: DemoFlight) -> Iterator[Wait]:
    """Each goal once; the ground crew replaces the battery whenever the vehicle comes for it."""
    service = flight.mission.grid.service

    def waits_for_battery() -> bool:
        return flight.command == 'recharge' and flight.on_ground and flight.cell == service

    def gone_on(over: set[str]) -> bool:
        return flight.over != over or waits_for_battery()

    flight.ask()  # The manager decides nothing before it is told what is wanted.
    yield 'the vehicle ready at the base', lambda: bool(flight.command) and flight.home
    flight.ask(**{goal.name: 2 for goal in flight.mission.goals})
    while not flight.asked <= flight.over:
        yield 'the next goal completed', partial(gone_on, flight.over)
        if waits_for_battery():
            flight.inject('ground crew: battery replaced', SIM_BATT_PCT=100)
            yield 'the command to fly on', lambda: not waits_for_battery()
    yield 'the landing at the base, or the service cell', lambda: bool(flight.place)
