"""Run the command."""

from uav_mission_manager.cli.mission_report import main

raise SystemExit(main())
