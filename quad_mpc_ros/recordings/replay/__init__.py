"""Replay of recordings: played in real time, or as input of a controller."""
