"""Run the demo."""

from uav_mission_manager.cli.demo.runner import main

raise SystemExit(main())
