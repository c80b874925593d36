"""What is estimated in flight: delay, disturbance, thrust, drag, lags, state on the ground."""
