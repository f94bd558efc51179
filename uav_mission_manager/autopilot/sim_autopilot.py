# PYTHON_ARGCOMPLETE_OK
"""Simulated autopilot: a small multirotor that speaks MAVLink 2 as ArduCopter does."""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

from pymavlink import mavutil

from uav_mission_manager.arguments import complete, version_line
from uav_mission_manager.autopilot.link import read_port
from uav_mission_manager.autopilot.simulator.battery import SMALL_PACK, Pack
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.frames import MOTOR_FRAMES
from uav_mission_manager.autopilot.simulator.link import SimulatedLink
from uav_mission_manager.autopilot.simulator.physics import SimulatedOrigin
from uav_mission_manager.autopilot.simulator.protocol import SimulatedAutopilot
from uav_mission_manager.output import flushed

DEFAULT_CONNECTION = 'udpout:127.0.0.1:14550'
"""Where ground stations and the bridge listen by default."""

CONNECTION_PREFIXES = ('udpout:', 'udpin:', 'tcpin:')
"""The kinds of pymavlink connection that are served."""

SIMULATION_STEP = 0.02
"""Simulated time [s] of a step: a choice, 50 Hz."""

MIN_SLEEP, MAX_SLEEP = 0.005, 0.02
"""Wall time [s] between two looks at the links: choices, quick answers for little work."""

MAX_CATCH_UP_TIME = 0.25
"""Wall time [s] that is made up for after a stall: a choice; what is more is lost."""

MAX_LATITUDE = 85.0
"""Latitude [deg] up to which the vehicle can stand: a choice, as north turns near a pole."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM; return the exit code."""
    parser = _parser()
    complete(parser)
    with flushed():
        options = parser.parse_args(arguments)
    names = options.connection or [DEFAULT_CONNECTION]
    try:
        ports = [mavutil.mavlink_connection(name) for name in names]
    except (OSError, ValueError) as error:
        parser.error(f'{" ".join(names)}: {error}')
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    frame = MOTOR_FRAMES[options.frame]
    flight = SimulatedFlight(
        options.origin, options.boot_seconds, options.seed, frame, options.battery
    )
    flight.parameters['SIM_SPEEDUP'] = options.speedup
    place = ','.join(str(value) for value in astuple(options.origin))
    with flushed():
        print(f'sim_autopilot: {" ".join(names)}, origin {place}, speed-up {options.speedup:g}')
    with contextlib.suppress(KeyboardInterrupt):
        _run(flight, ports, options.system_id, options.camera)
    return 0


def _run(flight: SimulatedFlight, ports: Sequence[Any], system: int, camera: bool) -> None:
    """Let simulated time follow wall time, for ever.

    What arrives is heard before each step: after a stall many are made at once.
    """
    links = [SimulatedLink(port, system) for port in ports]
    autopilot = SimulatedAutopilot(flight, links, system, camera)

    def hear() -> None:
        for port, link in zip(ports, links, strict=True):
            for data in read_port(port):
                autopilot.receive(link, data)

    def step_time() -> float:
        return SIMULATION_STEP / flight.parameters['SIM_SPEEDUP']

    owed, last = 0.0, time.monotonic()
    while True:
        time.sleep(min(max(step_time(), MIN_SLEEP), MAX_SLEEP))
        now = time.monotonic()
        owed += min(now - last, MAX_CATCH_UP_TIME)
        last = now
        hear()
        while owed >= step_time():
            owed -= step_time()
            autopilot.step(SIMULATION_STEP)
            hear()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='sim_autopilot', description=__doc__)
    parser.add_argument('--version', action='version', version=version_line())
    parser.add_argument(
        '--connection',
        type=_connection,
        action='append',
        metavar='STRING',
        help=f'udpout:, udpin: or tcpin:HOST:PORT; repeatable (default: {DEFAULT_CONNECTION})',
    )
    parser.add_argument(
        '--origin',
        type=_origin,
        default='-35.363262,149.165237,584',
        metavar='LAT,LON,ALT',
        help='where the vehicle stands: degrees, metres above sea level; a negative latitude '
        'needs --origin=LAT,LON,ALT (default: %(default)s)',
    )
    parser.add_argument(
        '--speedup',
        type=_positive,
        default=1.0,
        help='simulated seconds in a second (default: %(default)s)',
    )
    parser.add_argument(
        '--boot-seconds',
        type=_positive,
        default=5.0,
        help='simulated time until it has a position (default: %(default)s)',
    )
    parser.add_argument(
        '--system-id',
        type=int,
        default=1,
        choices=range(1, 256),
        metavar='ID',
        help='MAVLink system id (default: %(default)s)',
    )
    parser.add_argument(
        '--frame', choices=MOTOR_FRAMES, default='quad', help='of motors (default: %(default)s)'
    )
    parser.add_argument(
        '--battery',
        type=_battery,
        default=','.join(str(value) for value in astuple(SMALL_PACK)),
        metavar='CELLS,AH,WATTS',
        help='cells in series, capacity, and the power that hovering takes (default: %(default)s)',
    )
    parser.add_argument(
        '--camera', action='store_true', help='a camera is aboard, with heartbeats of its own'
    )
    parser.add_argument('--seed', type=int, default=0, help='of the motor noise and the gusts')
    return parser


def _connection(text: str) -> str:
    if not text.startswith(CONNECTION_PREFIXES):
        raise argparse.ArgumentTypeError(
            f'{text!r} does not begin with {", ".join(CONNECTION_PREFIXES)}'
        )
    return text


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f'{text} is not a positive number')
    return value


def _battery(text: str) -> Pack:
    try:
        cells, capacity, power = text.split(',')
        pack = Pack(int(cells), float(capacity), float(power))
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not CELLS,AH,WATTS') from None
    if not all(0.0 < value < math.inf for value in astuple(pack)):
        raise argparse.ArgumentTypeError(f'{text!r} is not three positive numbers')
    return pack


def _origin(text: str) -> SimulatedOrigin:
    try:
        latitude, longitude, altitude = (float(part) for part in text.split(','))
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not LAT,LON,ALT') from None
    if not (abs(latitude) <= MAX_LATITUDE and abs(longitude) <= 180.0 and math.isfinite(altitude)):
        raise argparse.ArgumentTypeError(f'{text!r} is not a place between 85 S and 85 N')
    return SimulatedOrigin(latitude, longitude, altitude)


if __name__ == '__main__':
    sys.exit(main())
