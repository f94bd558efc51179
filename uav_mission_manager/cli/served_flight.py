"""The page of a recorded flight, as the console would have shown it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from uav_mission_manager.cli.recorded_flight import recorded_flight, replayed_steps
from uav_mission_manager.console import DEFAULT_OLD_AFTER, page_serving
from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.other_policy import OtherPolicy
from uav_mission_manager.console.playback import Playback
from uav_mission_manager.console.policies import PolicyShelf
from uav_mission_manager.echo import shown
from uav_mission_manager.onboard.trace import Replay
from uav_mission_manager.policy import load_policy

HOST = '127.0.0.1'
"""Address of the page: this machine's own."""


def serve_flight(bag: Path, vehicle: str | None, policies: Sequence[str], port: int) -> NoReturn:
    """Serve the page until the command is interrupted.

    Parameters
    ----------
    bag, vehicle
        See `recorded_flight`.
    policies : sequence of str
        Folders of the policy sets whose decisions are shown beside those flown, see `Replay`.
    port : int
        0 is any that is free.
    """
    serving = page_serving()
    loaded, flight = [load_policy(policy) for policy in policies], recorded_flight(bag, vehicle)
    name = f'{shown(Path(policies[0]).name or policies[0], 60)} ({loaded[0].method})'
    steps = replayed_steps(bag, vehicle, Replay(*loaded))
    other = OtherPolicy(name, loaded[0].mission, steps)
    playback = Playback(flight, time.monotonic, other)
    fleet = Fleet(PolicyShelf(policies), lambda: playback.position, DEFAULT_OLD_AFTER)
    fleet.missions = tuple(policy.mission for policy in loaded)
    fleet.obstacle = 'this is a recording'
    listener = serving.listening_socket(HOST, port)
    server = serving.PageServer(fleet, listener, playback=playback)
    print(f'page: http://{HOST}:{listener.getsockname()[1]}/ until Ctrl-C', flush=True)
    try:
        while True:
            time.sleep(3600.0)
    finally:
        server.close()
