"""Run the command."""

from uav_mission_manager.cli.mission_new import main

raise SystemExit(main())
