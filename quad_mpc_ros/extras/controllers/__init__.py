"""Controllers from textbooks and autopilots, to compare with the MPC.

They command throttle and body rates from the same odometry, reference, mass and thrust curve.
"""
