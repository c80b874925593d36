"""Races through gates: courses, how a path passes them, plans of least time, gates that move.

May import the libraries and ``control``. On with ``--gates``, ``*.gates``, ``quad_mpc plan``.
"""
