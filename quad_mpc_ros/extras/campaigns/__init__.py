"""Many flights of the closed loop that differ: campaigns, tuning by them, rehearsal.

May import the libraries and ``control``. On with ``quad_mpc campaign``, ``tune``, ``rehearse``.
"""
