"""What is in the way: files and messages of it, ways around it, a sensor in simulation.

May import ``simulation`` (shapes), ``messages``, ``control``. :mod:`.avoidance` is the guide.
On with ``mpc.obstacles.half_spaces``, ``simulator.obstacles.file``, ``--obstacles``.
"""
