"""Many flights on purpose: campaigns, tuning, rehearsal, faults, the bench, and pages about them.

May import analysis, recordings and simulation; nothing here imports rclpy.
"""
