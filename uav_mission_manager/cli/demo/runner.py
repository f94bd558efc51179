"""The demo's command line, its loop and its summary."""

from __future__ import annotations

import argparse
import os
import random
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from uav_mission_manager.cli.demo.flight import DemoFlight
from uav_mission_manager.cli.demo.missions import (
    CASES,
    USUAL_CASES,
    DemoMission,
    mission_of,
    shipped_mission,
)
from uav_mission_manager.cli.demo.page import serve_page
from uav_mission_manager.cli.demo.stack import Stack
from uav_mission_manager.cli.demo.view import View
from uav_mission_manager.cli.errors import (
    CommandParser,
    look_for_interruption,
    one_line_errors,
    undisturbed,
)
from uav_mission_manager.cli.recording_options import add_recording_options, place_of_bags
from uav_mission_manager.echo import quoted
from uav_mission_manager.mdp import Energy, Mission, StateSpace
from uav_mission_manager.mdp.fields import positive
from uav_mission_manager.nodes.transport import without_shared_memory
from uav_mission_manager.onboard.recording import bag_names

MAX_WATCH_TIME = 45.0
"""Time [s] to watch the vehicle come home by itself after a process has ended: a choice."""

MAX_BLIND_TIME = 10.0
"""The same [s] where nothing can be seen of the vehicle any more: a choice."""


@dataclass(frozen=True)
class FlightResult:
    """How one mission ended; `failure` is empty where all went well, `place` in mid-air."""

    title: str
    failure: str
    asked: int
    achieved: int
    place: str
    seconds: float

    @property
    def good(self) -> bool:
        """Whether every goal was achieved and the vehicle is back and disarmed."""
        return not self.failure and self.achieved == self.asked and bool(self.place)


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('demo'):
        return _demonstrate(_parser().parse_args(args))


def _parser() -> CommandParser:
    parser = CommandParser(prog='demo', description='Fly two missions in simulation, or your own.')
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        'mission',
        nargs='?',
        choices=tuple(CASES),
        help=f'shipped mission to fly; default: {" and ".join(USUAL_CASES)}',
    )
    what.add_argument(
        '--policy',
        type=Path,
        metavar='DIR',
        help='fly the mission that this policy set was built from, each goal once, instead',
    )
    parser.add_argument(
        '--speedup',
        type=_speedup,
        default=8.0,
        help='simulated seconds per second; default: %(default)g',
    )
    parser.add_argument(
        '--no-page', action='store_true', help='do not serve the page of the console'
    )
    parser.add_argument('--logs', type=Path, help='directory for the logs; default: a new one')
    add_recording_options(
        parser, 'directory for the bags, one a mission; default: that of the logs'
    )
    return parser


def _speedup(text: str) -> float:
    try:
        return positive(float(text))
    except ValueError:
        raise argparse.ArgumentTypeError(f'{quoted(text)} is not a number above 0') from None


def _demonstrate(options: argparse.Namespace) -> int:
    # Other ROS systems neither hear nor disturb the demo.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(random.randint(1, 100)))
    logs = options.logs or Path(tempfile.mkdtemp(prefix='uav-demo-'))
    bags = place_of_bags(options, logs / 'bags')
    own = options.policy
    speedup, names = options.speedup, [options.mission] if options.mission else USUAL_CASES
    missions = (
        [mission_of(own, speedup)]
        if own
        else [shipped_mission(name, logs, speedup) for name in names]
    )
    results: list[FlightResult] = []
    without_shared_memory()
    with ExitStack() as page:
        if not options.no_page:
            policies = [mission.policy for mission in missions]
            print(page.enter_context(serve_page(policies, logs)), flush=True)
        for mission in missions:
            folder = mission.folder
            bag = bags and next(place for place in bag_names(bags / folder) if not place.exists())
            results.append(_fly(mission, logs / folder, speedup, bag))
            if not results[-1].good:
                break
    _summarise(results, logs)
    if bags is not None:
        print(f'bags: {bags}; see mission_replay {bag} --policy {mission.policy}')
        rest = f'--speedup {speedup:g} --out report.html'
        print(f'mission_report {bag} --policy {mission.policy} {rest}')
    return 0 if all(result.good for result in results) else 1


def _fly(planned: DemoMission, logs: Path, speedup: float, bag: Path | None) -> FlightResult:
    """Start the processes and fly one mission."""
    start = time.monotonic()
    mission, title = planned.mission, planned.title
    logs.mkdir(parents=True, exist_ok=True)
    mission_file = logs / 'mission.yaml'
    mission_file.write_text(yaml.safe_dump(mission.to_dict()))
    stack = Stack(mission_file, planned.policy, logs, speedup, bag)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    try:
        view = View(title, StateSpace.of(mission).names)
        view.start()
        flight = DemoFlight(mission, stack.crew_connection, view)
        executor.add_node(flight)
        stack.start(*_place_and_energy(mission))
        if bag is not None:
            view.event(f'recorded in {bag}')
        view.event('pids ' + ', '.join(f'{n} {p.pid}' for n, p in stack.processes.items()))
        failure = _play(planned, flight, stack, executor)
        achieved = len(flight.asked & set(flight.completed))
        seconds = time.monotonic() - start
        executor.remove_node(flight)
        flight.close()
        return FlightResult(title, failure, len(flight.asked), achieved, flight.place, seconds)
    finally:
        with undisturbed():
            stack.stop()
        executor.shutdown()
        rclpy.try_shutdown()


def _play(
    planned: DemoMission, flight: DemoFlight, stack: Stack, executor: SingleThreadedExecutor
) -> str:
    """Play the script to its end; return what went wrong, if anything."""
    recording = True
    for what, reached in planned.script(flight):
        limit = time.monotonic() + planned.limit
        while not reached():
            executor.spin_once(timeout_sec=0.1)
            look_for_interruption()
            if ended := stack.ended():
                who = ', '.join(f'{name} (exit code {code})' for name, code in ended.items())
                flight.view.event(f'ended: {who}; watching what the rest does')
                _watch(flight, stack, executor)
                return f'{who} ended while waiting for {what}'
            if recording and stack.recording_failed:
                recording = False
                flight.view.event(f'no longer recorded: see mission_record.log in {stack.logs}')
            if time.monotonic() > limit:
                return f'no sign of {what} within {planned.limit:.0f} s'
    return ''


def _watch(flight: DemoFlight, stack: Stack, executor: SingleThreadedExecutor) -> None:
    """Watch the rest of the chain bring the vehicle home, as far as it can."""
    seen = not {'sim_autopilot', 'mavlink_bridge'} & stack.ended().keys()
    limit = time.monotonic() + (MAX_WATCH_TIME if seen else MAX_BLIND_TIME)
    while time.monotonic() < limit:
        executor.spin_once(timeout_sec=0.1)
        look_for_interruption()
        if seen and flight.home:
            flight.view.event('the vehicle is home and disarmed')
            return


def _place_and_energy(mission: Mission) -> tuple[str, Energy]:
    origin, grid, energy = mission.grid.origin, mission.grid, mission.energy
    if origin is None or energy is None:
        missing = 'grid.origin' if origin is None else 'energy'
        raise ValueError(f'mission {mission.name}: {missing} is missing')
    latitude, longitude = origin.to_geodetic(*grid.position(grid.base))
    return f'{latitude:.9f},{longitude:.9f},{origin.altitude}', energy


def _summarise(results: list[FlightResult], logs: Path) -> None:
    print()
    for result in results:
        verdict = 'done' if result.good else f'FAILED: {result.failure or "goals left undone"}'
        print(
            f'{result.title}: {result.achieved} of {result.asked} goals achieved, vehicle '
            f'{f"{result.place} and disarmed" if result.place else "not home"}, '
            f'{result.seconds:.0f} s: {verdict}'
        )
    print(f'logs: {logs}')
