"""The page of a recorded flight, as the console would have shown it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NoReturn

from uav_mission_manager.cli.recorded_flight import recorded_flight
from uav_mission_manager.console import DEFAULT_OLD_AFTER, page_serving
from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.playback import Playback
from uav_mission_manager.console.policies import PolicyShelf

HOST = '127.0.0.1'
"""Address of the page: this machine's own."""


def serve_flight(bag: Path, vehicle: str | None, policy: str, port: int) -> NoReturn:
    """Serve the page until the command is interrupted.

    Parameters
    ----------
    bag, vehicle
        See `recorded_flight`.
    policy : str
        Folder of the policy set; with the one that was flown the page has map and forecast.
    port : int
        0 is any that is free.
    """
    serving = page_serving()
    shelf = PolicyShelf([policy])
    playback = Playback(recorded_flight(bag, vehicle), time.monotonic)
    fleet = Fleet(shelf, lambda: playback.position, DEFAULT_OLD_AFTER)
    fleet.obstacle = 'this is a recording'
    listener = serving.listening_socket(HOST, port)
    server = serving.PageServer(fleet, listener, playback=playback)
    print(f'page: http://{HOST}:{listener.getsockname()[1]}/ until Ctrl-C', flush=True)
    try:
        while True:
            time.sleep(3600.0)
    finally:
        server.close()
