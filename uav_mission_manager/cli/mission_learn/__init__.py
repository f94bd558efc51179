# PYTHON_ARGCOMPLETE_OK
"""`mission_learn`: what flights say of the numbers of a mission file."""

from uav_mission_manager.cli.mission_learn.command import main

__all__ = ['main']
