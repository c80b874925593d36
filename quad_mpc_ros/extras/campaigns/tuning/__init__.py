"""Tuning the controller by campaigns: Optuna proposes, the campaigns judge, a front remains."""
