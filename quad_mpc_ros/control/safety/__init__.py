"""Validation of inputs, failsafe levels, and limits of commands."""
