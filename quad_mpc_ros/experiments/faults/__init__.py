"""Faults: what is done to the controller's surroundings, and what it must make of it."""
