"""Analysis of recorded flights: identification, figures, report.

May import recordings and lower layers; nothing here imports rclpy.
"""
