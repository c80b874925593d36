"""Recordings once more: played in time, or solved again by another controller."""
