"""Evaluation of flights: figures of merit, waypoints, the summary on a terminal."""
