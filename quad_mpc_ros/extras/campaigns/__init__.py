"""Many simulated flights with varied parameters: campaigns, tuning and rehearsal.

May import the libraries and ``control``. Used by ``quad_mpc campaign``, ``tune``, ``rehearse``.
"""
