"""The controller: the control step (:mod:`.controller`, :mod:`.mpc`), safety, estimation, ocp,
model and lie. No I/O; times are arguments. Imports configuration only.
"""
