"""The ROS nodes: wiring between topics and what lives behind the other doors."""
