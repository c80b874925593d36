"""What can be found before a flight: findings, the checks that make them, and the facts they read.

The checks are functions without I/O. Nodes use those on their own parameters when they are
configured, ``quad_mpc preflight`` uses all of them on what it gathers over DDS.
"""
