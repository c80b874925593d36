"""Fields and bytes of messages: definitions, CDR, conversions, Betaflight's frames.

May import control; message packages of ROS are not needed here.
"""
