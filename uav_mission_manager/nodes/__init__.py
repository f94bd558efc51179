"""ROS 2 nodes: a callback converts, calls the pure core and publishes."""

from uav_mission_manager.nodes.ending import ENDING, need_ros, node_run

if node_run():
    ENDING.watch()  # The imports that follow take a second or more, and a signal may come in it.
    need_ros(node_run())
