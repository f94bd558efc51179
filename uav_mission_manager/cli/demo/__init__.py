# PYTHON_ARGCOMPLETE_OK
"""`demo`: the whole chain in one terminal, from the mission file to a landed vehicle.

Base station, manager, bridge and simulated autopilot run as processes of their own; the demo
plays the base station's operator, the enemy and the ground crew, and watches.
"""

from uav_mission_manager.cli.demo.runner import main

__all__ = ['main']
