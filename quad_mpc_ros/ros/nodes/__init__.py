"""The ROS nodes, which connect topics with the other packages."""
