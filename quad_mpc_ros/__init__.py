"""Model predictive control of a quadrotor on SO(3) for ROS 2.

Rooms, lowest first; imports point downwards only (see ``docs/architecture.md``):

``configuration``
    Declaration, validation and loading of parameters.
``core``
    The mathematics: SO(3), state, vehicle, dynamics, linearisation. NumPy only, no I/O.
``references``, ``control``
    What to fly, and the controller that flies it.
``simulation``
    The plant, and the closed loop without ROS.
``ros``
    Everything that knows a ROS message field, a QoS profile or an rclpy parameter.
``bags``, ``analysis``
    Recorded runs: writing, reading, metrics and figures.
``nodes``, ``bridges``, ``commands``
    Wiring: the ROS nodes, the flight-stack bridges and the ``quad_mpc`` command line.
"""

__version__ = "0.1.0"
