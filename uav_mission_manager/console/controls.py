"""The controls of one vehicle: each is confirmed, and says why where it cannot be used."""

from __future__ import annotations

from nicegui import ui

from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.heard import Heard, last_state
from uav_mission_manager.console.orders import (
    PRIORITY_NAMES,
    OperatorOrder,
    question,
    standing_priorities,
)
from uav_mission_manager.console.view import VehicleView
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import THREAT_LEVELS, Mission

BUTTONS = {'hold': 'Hold (h)', 'resume': 'Resume (r)', 'reload': 'Reload policy set'}
"""Orders without values, with the words on their buttons."""


class Controls:
    """Buttons of the vehicle that is shown, in the drawer in which it is made."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._vehicle, self._obstacle = '', 'no vehicle heard yet'
        self._mission: Mission | None = None
        self._told = fleet.answers[-1].number if fleet.answers else 0
        self._priorities: list[ui.toggle] = []
        self._touched = False
        self._build()

    def _build(self) -> None:
        self._why_not = ui.label().classes('obstacle')
        self._buttons = [
            ui.button(words, on_click=lambda kind=kind: self.ask(kind)).props('no-caps')
            for kind, words in BUTTONS.items()
        ]
        ui.label('Threat level').classes('label')
        levels = dict(enumerate(THREAT_LEVELS))
        self._threat = ui.toggle(levels, value=0).props('no-caps').classes('threat-choice')
        self._threat.on('click', self._touch)
        self._buttons.append(
            ui.button('Tell the manager', on_click=lambda: self.ask('threat')).props('no-caps')
        )
        ui.label('Priorities').classes('label')
        self._goals = ui.element('div').classes('priorities')
        self._buttons.append(
            ui.button('Ask for these', on_click=lambda: self.ask('priorities')).props('no-caps')
        )
        with ui.dialog() as self._dialog, ui.card():
            self._question = ui.label().classes('question')
            with ui.row():
                ui.button('Cancel', on_click=self._dialog.close).props('no-caps flat')
                ui.button('Yes', on_click=lambda: self._dialog.submit(True)).props('no-caps')

    def show(self, view: VehicleView, heard: Heard, mission: Mission | None) -> None:
        """Be the controls of a vehicle, in the state that it is in."""
        if view.name != self._vehicle or mission is not self._mission:
            self._vehicle, self._mission, self._touched = view.name, mission, False
            self._show_goals()
        if not self._touched:
            self._follow(heard)
        self._obstacle = view.obstacle
        self._why_not.text = view.obstacle
        for button in self._buttons:
            button.set_enabled(not view.obstacle)

    def _show_goals(self) -> None:
        self._goals.clear()
        goals = self._mission.goals if self._mission else ()
        options = dict(enumerate(PRIORITY_NAMES))
        self._priorities = []
        with self._goals:
            for goal in goals:
                ui.label(shown(goal.name, 40))
                toggle = ui.toggle(options, value=0).props('no-caps')
                self._priorities.append(toggle.on('click', self._touch))

    def _touch(self) -> None:
        """Keep what the operator has chosen, whatever is heard meanwhile, until it is ordered."""
        self._touched = True

    def _follow(self, heard: Heard) -> None:
        """Begin with what is so now: an order changes what the operator has changed, no more."""
        if heard.asked and self._mission:
            asked, state = heard.asked.value, last_state(heard.epochs)
            standing = standing_priorities(self._mission, asked, state)
            for toggle, value in zip(self._priorities, standing):
                toggle.value = value
        if heard.threat is not None:
            self._threat.value = THREAT_LEVELS.index(heard.threat.value)

    async def ask(self, kind: str) -> None:
        """Ask whether an order is meant, and give it."""
        if self._refused(kind) or self._dialog.value:
            return
        values: tuple[int, ...] = ()
        if kind == 'threat':
            values = (int(self._threat.value),)
        elif kind == 'priorities':
            values = tuple(int(toggle.value) for toggle in self._priorities)
        order = OperatorOrder(self._vehicle, kind, values)
        self._question.text = question(order, self._mission)
        if await self._dialog and not self._refused(kind):
            self._fleet.orders.put(order)
            self._touched = False

    def _refused(self, kind: str) -> bool:
        """Say why an order cannot be given now, if so."""
        if self._obstacle:
            ui.notify(f'{kind}: {self._obstacle}', type='warning')
        return bool(self._obstacle)

    def news(self) -> None:
        """Tell what became of orders since the last look."""
        for answer in self._fleet.answers:
            if answer.number > self._told:
                self._told = answer.number
                text = f'{answer.order.kind} {answer.order.vehicle}: {shown(answer.text)}'
                ui.notify(text, type='positive' if answer.good else 'negative', timeout=8000)
