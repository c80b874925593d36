"""Plants that need further packages: MuJoCo, real Betaflight firmware, rotorpy.

May import ``simulation`` and below, ``messages``; their parameters are declared in ``simulation``.
On with ``--plant NAME``, ``simulator.plant``; registered in setup.py.
"""
