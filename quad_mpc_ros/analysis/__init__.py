"""What recorded flights show: the vehicle identified from them, figures, report.

May import recordings and what is below; nothing here imports rclpy.
"""
