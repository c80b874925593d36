"""Flights evaluated: figures of merit, waypoints, the summary on a terminal."""
