"""Estimation in flight: delay compensation, EKF of motion and parameters, landing detection."""
