"""Simulation: plants, sensors, wind, and the closed loop in one process.

May import control and references; the plants' physics is written apart from the model's.
"""
