"""What is in the way, and how to keep clear of it.

:mod:`.avoidance` is what a controller is given; what it asks of a world is
:class:`.avoidance.Obstacles`.
"""
