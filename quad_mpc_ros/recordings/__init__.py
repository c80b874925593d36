"""Recorded runs: rosbag2 directories with MCAP, written and read without ROS.

``recording`` opens a run once and gives its flight as arrays; below it ``reader`` reads any bag,
message by message, ``writer`` writes one, and ``repair`` completes one that was cut short. Every
failure is a ``BagError``. Nothing here imports rclpy or a message package.
"""
