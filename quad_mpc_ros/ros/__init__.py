"""All that imports rclpy: lifecycle, parameters, spinning, the nodes and the bridges.

May import recordings, simulation and what is below; commands alone stand above it.
"""
