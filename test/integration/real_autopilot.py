"""A real ArduCopter, whose dynamics ArduPilot simulates, and the wire between it and a bridge.

`ARDUCOPTER_BIN` names its executable, built for SITL. Its default parameters lie in the source
tree that it was built from, or in the folder that `ARDUCOPTER_DEFAULTS` names.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

BINARY = os.environ.get('ARDUCOPTER_BIN', '')
FRAMES = {'quad': ('+', ('copter.parm',)), 'hexa': ('hexa', ('copter.parm', 'copter-hexa.parm'))}
"""Model and default parameters by frame."""


def defaults_folder() -> Path:
    """Return where the default parameters lie."""
    named = os.environ.get('ARDUCOPTER_DEFAULTS')
    tree = Path(BINARY).resolve().parents[3:4]  # TREE/build/sitl/bin/arducopter
    folder = Path(named or Path(*tree) / 'Tools' / 'autotest' / 'default_params')
    assert (folder / 'copter.parm').is_file(), f'no copter.parm in {folder}: ARDUCOPTER_DEFAULTS?'
    return folder


def free_port() -> int:
    """Return a UDP port of this machine that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class ArduCopter:
    """A running autopilot, with ports of its own made from a number."""

    def __init__(self, folder: Path, number: int, frame: str, home: str, serial0: str) -> None:
        model, files = FRAMES[frame]
        defaults = ','.join(str(defaults_folder() / name) for name in files)
        self.remote_control = free_port()
        self.folder = folder / 'arducopter'
        self.folder.mkdir()
        with (self.folder / 'output').open('w') as output:
            self._process = subprocess.Popen(
                [
                    *(
                        Path(BINARY).resolve(),
                        '-w',
                        f'-I{number}',
                        '--model',
                        model,
                        '--speedup',
                        '1',
                    ),
                    *('--home', home, '--defaults', defaults, '--serial0', serial0),
                    *('--rc-in-port', str(self.remote_control)),
                ],
                cwd=self.folder,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10.0)


class Wire(threading.Thread):
    """UDP between autopilot and bridge, where a ground station listens and speaks too."""

    def __init__(self, bridge_port: int, record: Path) -> None:
        super().__init__(daemon=True)
        self.whole = True
        self.seen: deque[tuple[bool, Any, bool]] = deque()
        """From the vehicle or from the bridge; a message; whether it got through."""
        self._to_bridge = ('127.0.0.1', bridge_port)
        self._to_vehicle: Any = None
        self._vehicle, self._bridge = (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)
        )
        for side in (self._vehicle, self._bridge):
            side.bind(('127.0.0.1', 0))
        self.port = self._vehicle.getsockname()[1]
        self._ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._lock = threading.Lock()
        self._parsers = {True: mavlink.MAVLink(None), False: mavlink.MAVLink(None)}
        for parser in self._parsers.values():
            parser.robust_parsing = True
        self._record = record.open('wb')
        self._over = threading.Event()

    def say(self, message: Any) -> None:
        """Send a message of the ground station to the autopilot."""
        with self._lock:
            if self._to_vehicle:
                self._vehicle.sendto(message.pack(self._ground), self._to_vehicle)

    def forge(self, message: Any, v1: bool) -> None:
        """Send a message to the bridge as if the autopilot had."""
        data = message.pack(mavlink.MAVLink(None, 1, 1), force_mavlink1=v1)
        self._bridge.sendto(data, self._to_bridge)

    def run(self) -> None:
        """Pass on what comes, and be a ground station."""
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
        )
        next_beat = 0.0
        while not self._over.is_set():
            if time.monotonic() >= next_beat:
                next_beat = time.monotonic() + 1.0
                self.say(beat)
            for side in select.select([self._vehicle, self._bridge], [], [], 0.1)[0]:
                self._pass_on(side)
        self._record.close()

    def _pass_on(self, side: socket.socket) -> None:
        data, address = side.recvfrom(4096)
        from_vehicle, through = side is self._vehicle, self.whole
        if from_vehicle:
            self._to_vehicle = address
        for message in self._parsers[from_vehicle].parse_buffer(data) or []:
            if message.get_type() != 'BAD_DATA':
                self.seen.append((from_vehicle, message, through))
                self._record.write(struct.pack('>Q', round(time.time() * 1e6)))
                self._record.write(message.get_msgbuf())
        if through and from_vehicle:
            self._bridge.sendto(data, self._to_bridge)
        elif through and self._to_vehicle:
            self._vehicle.sendto(data, self._to_vehicle)

    def close(self) -> None:
        """Stop."""
        self._over.set()
        self.join()
        self._vehicle.close()
        self._bridge.close()
