"""ROS 2 nodes: a callback converts, calls the pure core and publishes."""

import sys
from importlib.util import find_spec

from uav_mission_manager.nodes.ending import ENDING, node_run

if node_run():
    ENDING.watch()  # The imports that follow take a second or more, and a signal may come in it.
    if find_spec('rclpy') is None:
        sys.exit(f'{node_run()}: ROS 2 is not there: source its setup.bash first')
