# PYTHON_ARGCOMPLETE_OK
"""`demo`: the whole chain in one terminal, from the mission file to a landed vehicle.

Base station, manager, bridge and simulated autopilot run as processes of their own; the demo
plays the base station's operator, the enemy and the ground crew, and watches.
"""

from __future__ import annotations

from uav_mission_manager.nodes.ending import need_ros


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    need_ros('demo')
    from uav_mission_manager.cli.demo import runner

    return runner.main(args)
