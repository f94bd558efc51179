"""A forecast as a picture: goals done over time, and what it takes."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from uav_mission_manager.cli.errors import require_folder
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.epoch import SECONDS_PER_MINUTE
from uav_mission_manager.solver.evaluation.flights import Flights
from uav_mission_manager.solver.evaluation.forecast import (
    FORECAST_MINUTES,
    WITHIN_MINUTES,
    epoch_length,
    epochs_within,
    forecast,
)
from uav_mission_manager.solver.evaluation.intervals import Interval, proportion_of

MOST_POINTS = 200
"""Points of a curve, at most: a choice, more are not seen."""

LINES = {'-': 'solid', '--': 'dashed'}
"""Lines of the first policy and the second, and what they are called."""

GREYS = ('0.5', '0.8')
"""Their bars."""

HARDLY = 0.02
"""Share of flights that a curve may still gain after its last minute: a choice."""

LONGEST_NAME = 24
"""Characters of a goal's name in the legend, at most."""

BARS = {'recharges': 'recharges', 'repairs': 'repairs\n(tries)', 'agile_minutes': 'agile\n[min]'}
"""What the small panel shows of `Forecast.means`, and its labels."""


def require_plotting(file: Path) -> None:
    """Refuse a picture that cannot be drawn, before the work.

    Raises
    ------
    ValueError
        If Matplotlib is missing or does not know the file's format.
    OSError
        If there is no folder for the file.
    """
    # Which formats there are depends on the libraries that Matplotlib finds.
    formats = _matplotlib('figure').Figure().canvas.get_supported_filetypes()
    if file.suffix.removeprefix('.').lower() not in formats:
        known = ', '.join(f'.{name}' for name in sorted(formats))
        raise ValueError(f'--plot: {shown(file)} ends in none of {known}')
    require_folder('--plot', file)


def draw_forecast(runs: Sequence[Flights], names: Sequence[str], file: Path) -> None:
    """Draw one or two policies' flights; the file is there whole or not at all.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    figure = _matplotlib('figure').Figure(figsize=(9.0, 4.5), layout='constrained')
    curves, bars = figure.subplots(1, 2, width_ratios=(2.4, 1.0))
    _draw_curves(curves, runs)
    _draw_bars(bars, runs)
    count = f'{len(runs[0].costs):,} simulated flights, 95 % intervals'
    figure.suptitle(f'{runs[0].mission.name}: {count}', fontsize=11, parse_math=False)
    if len(runs) > 1:
        labels = [f'{name} ({style})' for name, style in zip(names, LINES.values())]
        legend = figure.legend(
            bars.containers[1::2], labels, loc='outside lower center', ncols=2, fontsize=8
        )
        _as_they_are(legend.get_texts())
    with tempfile.TemporaryDirectory(dir=file.parent) as folder:
        scratch = Path(folder, f'picture{file.suffix}')
        figure.savefig(scratch, dpi=150)
        scratch.replace(file)


def _matplotlib(module: str) -> Any:
    try:
        return import_module(f'matplotlib.{module}')
    except ImportError:
        raise ValueError(
            '--plot needs the Python package matplotlib: pip install matplotlib'
        ) from None


def _draw_curves(axes: Any, runs: Sequence[Flights]) -> None:
    """Share of flights in which each goal is done, over time, with its interval."""
    palette = list(_matplotlib('colors').TABLEAU_COLORS.values())
    for j, goal in enumerate(runs[0].mission.goals):
        colour, last = palette[j % len(palette)], []
        for run, style in zip(runs, LINES):
            minutes, found = _curve(run, j)
            low, value, high = (
                [100 * getattr(p, bound) for p in found] for bound in ('low', 'value', 'high')
            )
            axes.fill_between(minutes, low, high, step='post', color=colour, alpha=0.25, lw=0)
            axes.step(minutes, value, where='post', color=colour, ls=style, lw=1.5)
            last.append(f'{value[-1]:.1f}')
        axes.lines[-len(runs)].set_label(f'{shown(goal.name, LONGEST_NAME)}, {" / ".join(last)} %')
    for limit in WITHIN_MINUTES[:-1]:
        axes.axvline(limit, color='0.6', lw=0.8, ls=':')
    end, title = _end_of_interest(runs), f'done in {FORECAST_MINUTES} minutes'
    axes.set(xlim=(0, end), ylim=(0, 101), xlabel='time [min]', ylabel='done [%]')
    axes.grid(alpha=0.25)
    legend = axes.legend(loc='lower right', fontsize=8, title=title, title_fontsize=8)
    _as_they_are(legend.get_texts())


def _curve(run: Flights, goal: int) -> tuple[FloatArray, list[Interval]]:
    """Times [min], and the probability that a goal is done by each of them."""
    epochs = np.unique(np.linspace(0, run.epochs, MOST_POINTS + 1).astype(int))
    done = run.done[:, goal]
    counts = np.searchsorted(np.sort(done[done > 0]), epochs, side='right')
    found = [proportion_of(int(count), len(done)) for count in counts]
    return epochs * (epoch_length(run.mission) / SECONDS_PER_MINUTE), found


def _end_of_interest(runs: Sequence[Flights]) -> int:
    """The least of `WITHIN_MINUTES` after which hardly a goal is done for the first time [min]."""
    for limit in WITHIN_MINUTES:
        late = [(run.done > epochs_within(run.mission, limit)).mean(axis=0).max() for run in runs]
        if max(late) <= HARDLY:
            return limit
    return FORECAST_MINUTES


def _draw_bars(axes: Any, runs: Sequence[Flights]) -> None:
    """Means over the flights with their intervals."""
    height, rows = 0.8 / len(runs), np.arange(len(BARS))
    for position, run in enumerate(runs):
        means = [forecast(run).means[key] for key in BARS]
        values = [found.value for found in means]
        reach = [[m.value - m.low for m in means], [m.high - m.value for m in means]]
        bars = axes.barh(
            rows + (position - (len(runs) - 1) / 2) * height,
            values,
            0.9 * height,
            xerr=reach,
            color=GREYS[position],
            error_kw={'capsize': 3, 'lw': 1},
        )
        axes.bar_label(bars, [f'{value:.2f}' for value in values], padding=6, fontsize=8)
    axes.set_yticks(rows, BARS.values())
    axes.invert_yaxis()
    axes.margins(x=0.25)
    axes.set_xlabel(f'mean in {FORECAST_MINUTES} minutes')
    axes.spines[['top', 'right']].set_visible(False)


def _as_they_are(texts: Sequence[Any]) -> None:
    """Names may have dollar signs, which are no formulas."""
    for text in texts:
        text.set_parse_math(False)
