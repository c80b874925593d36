"""Bridges to Betaflight, Crazyflie, Crazyswarm2, ROSflight and Aerostack2, registered by setup.py.

May import ``ros.bridges``, on which bridges of other packages build too, ``messages`` and below.
On by starting the executable of the bridge, or with ``bridge:=NAME`` in a launch file.
"""
