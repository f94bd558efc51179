"""Polynomials of measured effectiveness as a picture."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from uav_mission_manager.learning.calibration import WHOLE, PolynomialFit
from uav_mission_manager.learning.posterior import LEVEL_TEXT

CURVE_POINTS = 101
"""Points of a curve: a choice, one for each percent."""


def draw_fits(fits: Sequence[PolynomialFit], failed_at: float, file: Path) -> None:
    """Draw each polynomial with its measurements and its interval; whole or not at all.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    quantities = sorted({fit.quantity for fit in fits})
    figure = import_module('matplotlib.figure').Figure(
        figsize=(4.5 * len(quantities), 4.0), layout='constrained'
    )
    panels = figure.subplots(1, len(quantities), squeeze=False)[0]
    for axes, quantity in zip(panels, quantities):
        for number, fit in enumerate(each for each in fits if each.quantity == quantity):
            _draw(axes, fit, failed_at, f'C{number}')
        axes.axvline(failed_at, color='0.6', lw=0.8, ls=':', label='a failed part')
        axes.set(xlabel='effectiveness [%]', ylabel=quantity.replace('_', ' '))
        axes.grid(alpha=0.25)
        axes.legend(fontsize=8)
    figure.suptitle(f'degree {fits[0].degree}, {LEVEL_TEXT} intervals of the mean', fontsize=10)
    with tempfile.TemporaryDirectory(dir=file.parent) as folder:
        scratch = Path(folder, f'picture{file.suffix}')
        figure.savefig(scratch, dpi=150)
        scratch.replace(file)


def _draw(axes: Any, fit: PolynomialFit, failed_at: float, colour: str) -> None:
    at = np.linspace(min(fit.at.min(), failed_at), WHOLE, CURVE_POINTS)
    values, low, high = zip(*map(fit, at))
    axes.plot(at, values, color=colour, lw=1.5, label=fit.part)
    axes.fill_between(at, low, high, color=colour, alpha=0.2, lw=0)
    axes.plot(fit.at, fit.values, 'o', color=colour, ms=4)
