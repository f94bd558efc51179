# PYTHON_ARGCOMPLETE_OK
"""`fault_calibrate`: from measured effectiveness to the faults of a mission file."""

from __future__ import annotations

import argparse
import math
from datetime import date
from itertools import groupby
from pathlib import Path

from uav_mission_manager.cli.calibration_plot import draw_fits
from uav_mission_manager.cli.errors import CommandParser, one_line_errors, require_folder
from uav_mission_manager.cli.forecast_plot import require_plotting
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.learning.calibration import WHOLE, PolynomialFit, fit_polynomial
from uav_mission_manager.learning.fault_numbers import FaultNumber, Fits, fault_numbers
from uav_mission_manager.learning.measurements import read_measurements
from uav_mission_manager.learning.mission_edit import Edit, edited, rounded
from uav_mission_manager.learning.new_mission import short
from uav_mission_manager.learning.posterior import LEVEL_TEXT
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.mdp.mission_file import load_mission, mission_file_text
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.paths import write_whole

DEFAULT_DEGREE = 2
"""Degree of the polynomials: a choice, the largest that three levels carry."""

MOST_DEGREE = 9
"""Largest degree: a choice, beyond sense."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('fault_calibrate'):
        options = _parser().parse_args(args)
        _check(options)
        fits = _fits(options.csv, options.degree)
        lowest = min(fit.at.min() for fit in fits.values())
        failed_at = lowest if options.failed_at is None else options.failed_at
        print('\n'.join(_fit_lines(fits)))
        if options.mission is not None:
            _calibrate(options, fits, failed_at)
        if options.plot is not None:
            draw_fits(list(fits.values()), failed_at, Path(options.plot))
            print(f'{shown(options.plot)}: written')
        return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='fault_calibrate',
        description='Fit polynomials to what was measured at reduced effectiveness of sensors, '
        'actuators and camera, and write what they give by fault mode into a mission file.',
    )
    parser.add_argument(
        'csv', help='measurements; columns: part, effectiveness [%%], quantity, value'
    )
    parser.add_argument('--mission', metavar='FILE', help='mission file whose faults it is about')
    parser.add_argument('--out', metavar='FILE', help='mission file to write')
    parser.add_argument('--plot', metavar='PNG', help='draw it, such as fits.png or .svg')
    parser.add_argument(
        '--degree',
        type=_degree,
        default=DEFAULT_DEGREE,
        help='of the polynomials; default: %(default)s',
    )
    parser.add_argument(
        '--failed-at',
        type=_percent,
        metavar='PERCENT',
        help='effectiveness of a part that has failed; default: the lowest that was measured',
    )
    return parser


def _degree(text: str) -> int:
    if not (text.isdecimal() and len(text) == 1 and int(text) <= MOST_DEGREE):
        raise argparse.ArgumentTypeError(f'{quoted(text)} is no whole number from 0 to 9')
    return int(text)


def _percent(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= WHOLE:
        raise argparse.ArgumentTypeError(f'{quoted(text)} is not a number from 0 to 100')
    return value


def _check(options: argparse.Namespace) -> None:
    """Refuse what cannot be written before the work."""
    if options.out is not None:
        if options.mission is None:
            raise ValueError('--out: needs --mission, the file that it is a changed copy of')
        require_folder('--out', Path(options.out))
    if options.plot is not None:
        require_plotting(Path(options.plot))


def _fits(path: str, degree: int) -> Fits:
    measurements = sorted(read_measurements(Path(path)), key=lambda m: (m.part, m.quantity))
    try:
        return {
            key: fit_polynomial(list(group), degree)
            for key, group in groupby(measurements, lambda m: (m.part, m.quantity))
        }
    except ValueError as error:
        raise ValueError(f'{shown(path)}: {error}') from None


def _fit_lines(fits: Fits) -> list[str]:
    lines = []
    for fit in fits.values():
        terms = ' '.join(
            f'{coefficient:+.4g}' + (f' e^{power}' if power else '')
            for power, coefficient in enumerate(fit.coefficients)
        )
        lines.append(
            f'{fit.part} {fit.quantity}: {terms}; {len(fit.at)} measurements from '
            f'{fit.at.min():g} to {fit.at.max():g} %; {error_text(fit)}'
        )
    return lines


def error_text(fit: PolynomialFit) -> str:
    """Say how well a polynomial fits."""
    if math.isnan(fit.residual):
        return 'as many coefficients as measurements: its error is not known'
    left_out = 'not known' if math.isnan(fit.leave_one_out) else short(fit.leave_one_out)
    return f'residual {short(fit.residual)}, leave-one-out {left_out}'


def _calibrate(options: argparse.Namespace, fits: Fits, failed_at: float) -> None:
    mission, text = load_mission(options.mission), mission_file_text(options.mission)
    try:
        numbers = fault_numbers(fits, mission, read_yaml(text), failed_at)
    except Bad as error:
        raise ValueError(f'{shown(options.mission)}: {error}') from None
    print(f'A failed part is taken at an effectiveness of {failed_at:g} %.')
    for found in numbers:
        print(f'{found.field}: {_told(found)}')
    if options.out is not None:
        source = f'{Path(options.csv).name}, {date.today().isoformat()}, degree {options.degree}'
        edits = [
            Edit(
                n.path,
                rounded(n.path, n.value),
                f'calibrated {n.field}: {_told(n)}; from {source}',
            )
            for n in numbers
        ]
        new = edited(text, options.mission, edits)
        mission_from_dict(read_yaml(new), options.out)
        write_whole(Path(options.out), new)
        print(f'{shown(options.out)}: written')


def _told(found: FaultNumber) -> str:
    """Say a number, how sure it is, and what was done to it."""
    parts = [short(found.value)]
    if math.isfinite(found.found.low):
        low, high = short(found.found.low), short(found.found.high)
        of = f' {found.fit.quantity}' if found.fit else ''
        parts.append(f'fit{of} {short(found.found.value)}, {LEVEL_TEXT} {low} to {high}')
    elif found.fit is None:
        parts.append('of the polynomials of several parts')
    if found.fit is not None:
        parts.append(error_text(found.fit))
    if found.clipped:
        parts.append(f'{short(found.found.value)} brought to {found.clipped}')
    if found.extrapolated:
        parts.append('beyond what was measured')
    return f'{"; ".join(parts)}; was {short(found.old)}'


if __name__ == '__main__':
    raise SystemExit(main())
