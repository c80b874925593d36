"""Fields and bytes of messages: definitions, CDR, conversions, Betaflight's frames.

May import control; ROS message packages are not needed here.
"""
