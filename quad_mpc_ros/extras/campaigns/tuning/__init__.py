"""Tuning of the controller: Optuna proposes parameters, campaigns evaluate them."""
