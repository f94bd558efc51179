"""The options of `mission_new`."""

from __future__ import annotations

import argparse
import math

from uav_mission_manager.cli.errors import CommandParser
from uav_mission_manager.cli.mission_new.found import ROLES, Place, point_of
from uav_mission_manager.echo import quoted
from uav_mission_manager.mdp.fields import Bad, name, number, within
from uav_mission_manager.mdp.mission_table import MAX_CELLS

FIT = 'fit'
"""In place of a bearing: the one that is found by the places."""


def options_parser() -> CommandParser:
    """Return what reads the options."""
    parser = CommandParser(
        prog='mission_new',
        description='Make a mission file from a plan of QGroundControl, a KML or GeoJSON file, or '
        'from --goal and --home alone. Points, areas and surveys become goals. Probabilities '
        'and costs are guesses to be replaced. Write --home=-35.3,149.1, with =, where the '
        'latitude is negative.',
    )
    parser.add_argument('file', nargs='?', help='.plan, .kml, .geojson')
    parser.add_argument('--out', required=True, metavar='MISSION', help='mission file to write')
    parser.add_argument('--force', action='store_true', help='overwrite MISSION')
    parser.add_argument('--name', type=_name, help="of the mission; default: MISSION's")
    _add_places(parser.add_argument_group('places'))
    _add_grid(parser.add_argument_group('grid and flight'))
    return parser


def _add_places(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        '--home',
        type=_place,
        metavar='PLACE',
        help='base: LATITUDE,LONGITUDE[,ALTITUDE above sea level] or a name in the file; '
        'default: that of the plan, or a point called home',
    )
    group.add_argument(
        '--service',
        type=_place,
        metavar='PLACE',
        help='where it is recharged and repaired; default: home',
    )
    group.add_argument(
        '--polygons',
        choices=ROLES,
        default='goal',
        help='what areas of KML and GeoJSON are; default: %(default)s',
    )
    for option, metavar, read, text in (
        ('--goal', 'NAME,LATITUDE,LONGITUDE', _goal, 'one more goal'),
        ('--skip', 'NAME', str, 'leave a point or an area out'),
        ('--line', 'NAME', str, 'a line to fly along, as one more goal'),
        ('--no-fly', 'NAME', str, 'an area not to fly over'),
        ('--fence', 'NAME', str, 'the area to stay in'),
        ('--worth', 'NAME=WORTH', _worth, 'how much a goal matters; an ordinary one 1'),
    ):
        group.add_argument(
            option,
            action='append',
            default=[],
            type=read,
            metavar=metavar,
            help=f'{text}; may be repeated',
        )


def _add_grid(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        '--cell',
        type=_positive,
        metavar='SIZE',
        help='width of a cell [m]; default: ten along the longer side, or as goals need it',
    )
    group.add_argument('--rows', type=_count, metavar='N', help='with --cols, in place of --cell')
    group.add_argument('--cols', type=_count, metavar='N', help='with --rows')
    group.add_argument(
        '--turn',
        type=_bearing,
        default=0.0,
        metavar='DEG',
        help=f'turn the grid clockwise [deg]; {FIT}: as the smallest box around all places lies',
    )
    group.add_argument(
        '--speed', type=_positive, metavar='V', help="of flight [m/s]; default: the plan's, or 5"
    )
    group.add_argument(
        '--altitude',
        type=_positive,
        metavar='H',
        help="height of flight above home [m], which is the bridge's parameter flight_altitude: "
        "it is noted in the file; default: the plan's",
    )


def _refused(error: Bad) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(str(error))


def _number(text: str) -> float:
    try:
        return number(float(text))
    except Bad as error:
        raise _refused(error) from None
    except ValueError:
        raise argparse.ArgumentTypeError(f'{quoted(text)} is not a number') from None


def _bearing(text: str) -> float | str:
    try:
        return FIT if text == FIT else within(-360.0, 360.0)(_number(text))
    except Bad as error:
        raise _refused(error) from None


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f'{quoted(text)} is not above 0')
    return value


def _count(text: str) -> int:
    value = _number(text)
    if not 1.0 <= value <= MAX_CELLS or value != math.floor(value):
        raise argparse.ArgumentTypeError(f'{quoted(text)} is no whole number of 1..{MAX_CELLS}')
    return int(value)


def _name(text: str) -> str:
    try:
        return name(text)
    except Bad as error:
        raise _refused(error) from None


def _worth(text: str) -> tuple[str, float]:
    goal, equals, worth = text.rpartition('=')
    if not (goal and equals):
        raise argparse.ArgumentTypeError(f'{quoted(text)} is not NAME=WORTH')
    value = _number(worth)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f'{quoted(text)}: {value:g} is negative')
    return goal, value


def _goal(text: str) -> tuple[str, tuple[float, float]]:
    goal, *position = text.rsplit(',', 2)
    if len(position) != 2 or not goal:
        raise argparse.ArgumentTypeError(f'{quoted(text)} is not NAME,LATITUDE,LONGITUDE')
    return goal, _point([_number(part) for part in position])


def _place(text: str) -> Place | str:
    """Return a position, or the name that it is."""
    parts = text.split(',')
    try:
        values = [float(part) for part in parts]
    except ValueError:
        return text
    if len(values) not in (2, 3):
        return text
    altitude = _number(parts[2]) if len(parts) == 3 else None
    return Place('given', *_point(values), text, altitude)


def _point(values: list[float]) -> tuple[float, float]:
    try:
        return point_of(values)
    except Bad as error:
        raise _refused(error) from None
