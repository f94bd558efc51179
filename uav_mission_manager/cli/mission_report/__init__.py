# PYTHON_ARGCOMPLETE_OK
"""`mission_report`: what happened in a flight, or what a policy set is, as one HTML file."""

from uav_mission_manager.cli.mission_report.command import main

__all__ = ['main']
