"""What is estimated in flight: delay, disturbance, thrust, drag, lags, ground contact."""
