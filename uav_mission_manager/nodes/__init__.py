"""ROS 2 nodes: a callback converts, calls the pure core and publishes."""

from uav_mission_manager.nodes.ending import ENDING, runs_node

if runs_node():  # The imports that follow take a second or more, and a signal may come in it.
    ENDING.watch()
