"""Run the demo."""

from uav_mission_manager.cli.demo import main

raise SystemExit(main())
