"""What is to be flown: trajectories, their feasibility, and the windows cut out of them.

The director decides which comes when. May import control (model, safety) and configuration.
"""
