"""The vehicle over MAVLink: link, telemetry, faults, the pilot on board, a simulated autopilot."""
