"""Flying by hand: what keys and sticks ask for, without ROS; the node is in ``ros/nodes``."""
