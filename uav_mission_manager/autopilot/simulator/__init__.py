"""A simulated multirotor: physics and flight modes without MAVLink, and a MAVLink front."""
