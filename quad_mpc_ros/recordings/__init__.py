"""Recorded runs: rosbag2 directories with MCAP, written and read without ROS.

``recording`` opens a run once and gives its flight as arrays; below it ``reader`` reads any bag,
message by message, ``writer`` writes one, and ``repair`` completes one that was cut short. Every
failure is a ``BagError``. ``evaluation`` measures flights,
``replay`` plays them or solves them again. May import simulation, messages and what is below.
"""
