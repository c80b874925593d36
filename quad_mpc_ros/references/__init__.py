"""Trajectories, their feasibility, and the windows cut from them.

The director selects the active trajectory. May import control (model, safety) and configuration.
"""
