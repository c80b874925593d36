"""What is accepted, who commands the vehicle, and within which limits."""
