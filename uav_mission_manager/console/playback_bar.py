"""Play, pause, speed and a scrubber of a recorded flight, on the page."""

from __future__ import annotations

from collections.abc import Sequence

from nicegui import ui
from nicegui.events import GenericEventArguments

from uav_mission_manager.console.playback import SPEEDS, Playback

SEEK_PERIOD = 0.1
"""Time [s] between two places that a dragged scrubber tells: a choice."""


class PlaybackBar:
    """The bar; it is made where it shall be."""

    def __init__(self, playback: Playback) -> None:
        self._playback, self._dragged = playback, False
        with ui.element('div').classes('playback'):
            self._button = ui.button(icon='play_arrow', on_click=playback.toggle).tooltip('p')
            self._button.props('aria-label="Play or pause"')
            speeds = {speed: f'{speed:g} x' for speed in SPEEDS}
            ui.toggle(speeds, value=1, on_change=lambda e: playback.set_speed(e.value)).props(
                'no-caps dense'
            )
            if playback.other is not None:
                ui.button(icon='skip_next', on_click=playback.seek_difference).tooltip(
                    'where the other policy next decides otherwise: n'
                ).props('aria-label="Next difference"')
            with ui.element('div').classes('scrubber'):
                self._slider = ui.slider(
                    min=0.0, max=playback.flight.duration, step=0.1, value=0.0
                )
                if playback.other is not None:
                    ui.html(
                        differences_svg(playback.other.differences, playback.flight.duration),
                        sanitize=False,
                    )
            self._slider.props('aria-label="Time in the flight"')
            self._slider.on('update:model-value', self._on_slide, throttle=SEEK_PERIOD)
            self._slider.on('pan', self._on_pan)
            self._time = ui.label().classes('time')

    def show(self) -> None:
        """Be where the flight is now."""
        playback = self._playback
        position, end = playback.position, playback.flight.duration
        running = playback.playing and not playback.ended
        self._button.props(f'icon={"pause" if running else "play_arrow"}')
        self._time.text = f'{_clock(position)} of {_clock(end)}'
        if not self._dragged:
            self._slider.value = round(position, 1)

    def _on_slide(self, event: GenericEventArguments) -> None:
        self._playback.seek(float(event.args))

    def _on_pan(self, event: GenericEventArguments) -> None:
        self._dragged = event.args == 'start'


def differences_svg(differences: Sequence[tuple[float, float]], duration: float) -> str:
    """Mark on the scrubber from when to when [s] another policy decides otherwise."""
    marks = ''.join(
        f'<rect x="{start:.3f}" y="0" width="{max(end - start, duration / 500):.3f}" height="1">'
        f'<title>decides otherwise from {_clock(start)} to {_clock(end)}</title></rect>'
        for start, end in differences
    )
    return (
        f'<svg class="differences" viewBox="0 0 {duration:.3f} 1" preserveAspectRatio="none" '
        f'role="img" aria-label="{len(differences)} differences">{marks}</svg>'
    )


def _clock(seconds: float) -> str:
    """Minutes and seconds."""
    minutes, rest = divmod(int(seconds), 60)
    return f'{minutes}:{rest:02}'
