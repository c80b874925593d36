"""Recorded runs: rosbag2 directories with MCAP, written and read without ROS.

``writer`` writes a bag, ``reader`` reads one, ``repair`` completes one that was cut short. Every
failure is a ``BagError``. Nothing here imports rclpy or a message package.
"""
