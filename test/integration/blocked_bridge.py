"""The bridge with a serial device each of whose calls waits for ever."""

from __future__ import annotations

import sys
import threading

from uav_mission_manager.autopilot import port
from uav_mission_manager.nodes.mavlink_bridge import main


class BlockedDevice:
    """Waits in every call; `open` at the end of the path says in which the first time."""

    def __init__(self, device: str, baud: int) -> None:
        self._wait('open', device)
        self._device = device

    def _wait(self, call: str, device: str) -> None:
        if call in device:
            threading.Event().wait()

    def recv(self, size: int) -> bytes:
        self._wait('recv', self._device)
        return b'noise'

    def write(self, data: bytes) -> None:
        self._wait('write', self._device)

    def close(self) -> None:
        self._wait('close', self._device)


port.SerialWire = BlockedDevice
if __name__ == '__main__':
    sys.exit(main())
