"""Recorded runs: rosbag2 directories with MCAP, written and read without ROS.

``recording`` gives the flight in a bag as arrays, ``reader`` reads any bag message by message,
``writer`` writes one, ``repair`` completes one that was cut short; every failure is a
``BagError``. ``evaluation`` measures flights, ``replay`` plays or solves them again. May import
simulation, references, control, messages and configuration.
"""
