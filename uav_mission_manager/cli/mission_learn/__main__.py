"""Run the command."""

from uav_mission_manager.cli.mission_learn import main

raise SystemExit(main())
