"""Trajectories, their feasibility, and the windows cut from them.

The director decides which comes when. May import control (model, safety) and configuration.
"""
