"""ROS 2 nodes: a callback converts, calls the pure core and publishes."""
