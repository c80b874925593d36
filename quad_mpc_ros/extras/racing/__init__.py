"""Races through gates: courses, gate passages, time-optimal plans.

May import the libraries and ``control``. Enabled with ``--gates``, ``*.gates``, ``quad_mpc plan``.
"""
