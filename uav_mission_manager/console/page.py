"""The page of one browser: it looks at the fleet time and again and sends what has changed."""

from __future__ import annotations

from nicegui import ui
from nicegui.events import KeyEventArguments

from uav_mission_manager.console.controls import Controls
from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.forecasting import FORECAST_FLIGHTS
from uav_mission_manager.console.heard import Heard, last_state
from uav_mission_manager.console.map_overlay import base_layer, goal_layer, moving_layer
from uav_mission_manager.console.markup import (
    bars_html,
    forecast_html,
    log_html,
    now_html,
    other_html,
    rest_html,
    tile_html,
    top_html,
)
from uav_mission_manager.console.playback import Playback
from uav_mission_manager.console.playback_bar import PlaybackBar
from uav_mission_manager.console.style import PAGE_STYLE
from uav_mission_manager.console.timeline import block_svg, blocks, row_names
from uav_mission_manager.mdp import Mission, StateSpace

LOOK_PERIOD = 0.1
"""Time [s] between two looks at the fleet: a choice, half of what an eye may wait for."""

LINES_SHOWN = 40
"""Lines of the log on the page: a choice; more are in the log of the node."""

KEYS_HELP = 'Keys: c controls, h hold, r resume, d light or dark, 1 to 9 and arrows the vehicle'


def define_page(fleet: Fleet, playback: Playback | None = None) -> None:
    """Say what a browser gets that asks for `/`: vehicles as they are, or a recorded flight."""

    @ui.page('/', title='uav_mission_manager', response_timeout=10)
    def main_page() -> None:
        ui.add_css(PAGE_STYLE)
        VehiclePage(fleet, playback)


class VehiclePage:
    """One vehicle at large, the others as tiles."""

    def __init__(self, fleet: Fleet, playback: Playback | None) -> None:
        self._fleet, self._playback = fleet, playback
        self._selected = ''
        self._seen: dict[str, tuple[Heard, int]] = {}
        self._mission: Mission | None = None
        self._blocks: list[ui.html] = []
        self._drawn: list[tuple[int, int]] = []
        self._tiles: dict[str, ui.html] = {}
        self._dark = ui.dark_mode(None)
        self._others: dict[int, str] | None = None
        if playback is not None and playback.other is not None:
            self._others = playback.other.by_epoch(playback.flight.epochs)
        self._build()
        ui.keyboard(self._on_key, ignore=['input', 'select', 'textarea'])
        self._look()
        ui.timer(LOOK_PERIOD, self._look)

    def _build(self) -> None:
        self._root = ui.element('main').classes('console')
        with self._root:
            with ui.element('header').classes('area-head'):
                self._top = _html()
                with ui.element('div').classes('buttons'):
                    ui.button('Controls', icon='tune', on_click=self._toggle_drawer).props(
                        'no-caps'
                    ).tooltip(KEYS_HELP)
            self._tile_row = ui.element('nav').classes('area-tiles')
            if self._playback is not None:
                with self._tile_row:
                    self._bar = PlaybackBar(self._playback)
            with ui.element('section').classes('area-map box'):
                self._base, self._goals, self._moving = (_html() for _ in range(3))
            with ui.element('section').classes('area-side box'):
                self._now, self._other, self._actions, self._parts, self._forecast = (
                    _html() for _ in range(5)
                )
            with ui.element('section').classes('area-time box'):
                self._names = _html('timeline-names')
                with ui.element('div').classes('time-scroll'):
                    self._time = ui.element('div')
            with ui.element('section').classes('area-log box'):
                self._log = _html()
            with ui.element('aside').classes('area-drawer box'):
                self._controls = Controls(self._fleet)

    def _toggle_drawer(self) -> None:
        self._root.classes(toggle='with-drawer')

    async def _on_key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown or event.action.repeat:
            return
        key, names = str(event.key), self._fleet.names
        if key == 'c':
            self._toggle_drawer()
        elif key == 'd':
            self._dark.value = not self._dark.value
        elif key == 'p' and self._playback is not None:
            self._playback.toggle()
        elif key == 'n' and self._playback is not None:
            self._playback.seek_difference()
        elif key in ('h', 'r'):
            await self._controls.ask({'h': 'hold', 'r': 'resume'}[key])
        elif key.isdigit() and 0 < int(key) <= len(names):
            self._select(names[int(key) - 1])
        elif key in ('ArrowLeft', 'ArrowRight') and self._selected in names:
            step = 1 if key == 'ArrowRight' else -1
            self._select(names[(names.index(self._selected) + step) % len(names)])

    def _select(self, vehicle: str) -> None:
        self._selected = vehicle
        if vehicle in self._fleet.heard:
            self._fleet.attended.add(vehicle)
        self._seen.clear()

    def _look(self) -> None:
        """Send what has changed since the last look; ages change by the second."""
        if self._playback is not None:
            self._fleet.heard = {self._playback.flight.vehicle: self._playback.heard()}
            self._bar.show()
        names = self._fleet.names
        if self._selected not in names:
            self._select(names[0] if names else '')
        second = int(self._fleet.clock())
        for name in names:
            moment = self._fleet.heard[name], second
            last = self._seen.get(name)
            if last is not None and last[0] is moment[0] and last[1] == second:
                continue
            self._seen[name] = moment
            self._show_tile(name, len(names))
            if name == self._selected:
                self._show(name, moment[0])
        if not names:
            self._top.content = (
                '<div class="top"><div class="vehicle">no vehicle heard yet</div></div>'
            )
        self._controls.news()

    def _show_tile(self, name: str, vehicles: int) -> None:
        if vehicles < 2:
            return
        if name not in self._tiles:
            with self._tile_row:
                tile = self._tiles[name] = _html()
            tile.on('click', lambda: self._select(name))
        view = self._fleet.view(name)
        self._tiles[name].content = tile_html(view, name == self._selected)

    def _show(self, name: str, heard: Heard) -> None:
        view, policy = self._fleet.view(name), self._fleet.policy(name)
        old = view.now.headline.tone in ('stale', 'danger')  # Nothing is decided now.
        mission = self._fleet.mission_of(name)
        self._top.content = top_html(view)
        self._now.content = now_html(view.now)
        self._show_other(heard)
        title = 'what each action costs more than the best'
        bars = bars_html(title, view.now.actions)
        self._actions.content = bars + rest_html(view.now.forbidden, view.now.dearer)
        self._parts.content = bars_html('expected cost by sub-MDP', view.now.parts)
        self._forecast.content = self._forecast_html(name, heard, policy is not None, old)
        self._log.content = log_html(heard.log[-LINES_SHOWN:])
        self._controls.show(view, heard, mission)
        self._show_map(name, heard, mission, old)
        self._show_time(heard, mission)

    def _forecast_html(self, name: str, heard: Heard, at_hand: bool, old: bool) -> str:
        """The forecast from the present state, or why there is none."""
        if old or heard.decision is None:
            return forecast_html(None, 'nothing is decided now')
        if not at_hand:
            return forecast_html(None, 'the policy set is not at hand here')
        found = self._fleet.forecast(name)
        if found is None or found.trouble:
            return forecast_html(None, found.trouble if found else 'not yet')
        of = 'from here' if heard.decision.value.state == found.state else 'from a moment ago'
        if not found.chances:
            return forecast_html(None, f'{of}: no goal is wanted')
        return forecast_html(found.chances, f'{of}, by {FORECAST_FLIGHTS} simulated flights')

    def _show_other(self, heard: Heard) -> None:
        """Show what another policy would have done at this moment of a flight."""
        playback = self._playback
        if playback is None or playback.other is None:
            return
        other, state = playback.other.at(playback.position), last_state(heard.epochs)
        at_base = bool(state) and state[-4] == playback.other.mission.grid.base
        self._other.content = other_html(playback.other.name, other, at_base) if other else ''

    def _show_map(self, name: str, heard: Heard, mission: Mission | None, old: bool) -> None:
        if mission is None:
            self._base.content = '<p class="note">no map: the policy set is not at hand here</p>'
            self._goals.content = self._moving.content = ''
            return
        if mission is not self._mission:
            self._mission = mission
            self._base.content = base_layer(mission)
        self._goals.content = goal_layer(mission, heard, old)
        crafts = self._fleet.crafts(mission)
        self._moving.content = moving_layer(mission, heard, name, crafts)

    def _show_time(self, heard: Heard, mission: Mission | None) -> None:
        """Draw the blocks of the timeline that have changed."""
        space, others = StateSpace.of(mission) if mission else StateSpace(0, 1), self._others
        goals = [goal.name for goal in mission.goals] if mission else ()
        names = row_names(goals, space.levels, others is not None)
        self._names.content = '\n'.join(names)
        found = blocks(heard.epochs)
        while len(self._blocks) > len(found):
            self._blocks.pop().delete()
            self._drawn.pop()
        for position, block in enumerate(found):
            if position == len(self._blocks):
                with self._time:
                    self._blocks.append(_html())
                self._drawn.append((0, 0))
            key = id(block[0]), id(block[-1])
            if self._drawn[position] != key:
                self._drawn[position] = key
                self._blocks[position].content = block_svg(block, space, others, mission)


def _html(classes: str = '') -> ui.html:
    """An empty part; what is put there is escaped where it is made."""
    return ui.html('', sanitize=False).classes(classes)
