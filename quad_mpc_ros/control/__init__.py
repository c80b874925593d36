"""What flies: the control cycle (:mod:`.controller`, :mod:`.mpc`), and below it safety,
estimation, ocp, model and lie. No I/O; time comes in as numbers. May import configuration only.
"""
