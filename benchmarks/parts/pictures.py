"""How the benchmarks draw: the same bytes each time, readable in print and by the colour-blind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

BLUE, ORANGE, GREEN, PURPLE, SKY = '#0072b2', '#e69f00', '#009e73', '#cc79a7', '#56b4e9'
"""Colours that the colour-blind tell apart (Okabe and Ito 2008)."""


def drawing(name: str) -> Any:
    """Return pyplot, made ready to write an SVG of this name without chance or date in it."""
    import matplotlib as mpl

    mpl.use('svg')
    from matplotlib import pyplot

    pyplot.rcParams.update({'svg.hashsalt': name, 'svg.fonttype': 'none'})
    return pyplot


def save(figure: Any, file: Path) -> None:
    """Write a picture."""
    figure.savefig(file, metadata={'Date': None})
