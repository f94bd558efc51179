"""How messages travel: by UDP alone, for a process that dies leaves shared memory half made.

Fast DDS, ROS's default, opens the shared memory of each process on the machine. Of one that was
killed while it made its own, all who send to it wait for ever, and so does who is started in its
place.
"""

from __future__ import annotations

import os
from pathlib import Path

LOOPBACK_PROFILE = Path(__file__).with_name('loopback.xml')
"""Profile of Fast DDS for this machine alone."""

_RANGE, _PROFILES = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'FASTRTPS_DEFAULT_PROFILES_FILE'


def without_shared_memory() -> None:
    """Have Fast DDS use no shared memory; call it before `rclpy.init`.

    Whoever has given it profiles of their own, or named its transports, is left alone.
    """
    own = str(LOOPBACK_PROFILE)
    if os.environ.get(_PROFILES, own) != own or 'FASTDDS_DEFAULT_PROFILES_FILE' in os.environ:
        return
    os.environ.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    if os.environ.get(_RANGE) == 'LOCALHOST':  # ROS then insists on shared memory.
        os.environ[_RANGE], os.environ[_PROFILES] = 'SYSTEM_DEFAULT', own
