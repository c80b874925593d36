"""A Crazyflie over radio, USB or UDP, by CRTP: rates and thrust out, telemetry back."""

from quad_mpc_ros.extras.bridges.crazyflie.bridge import CrazyflieBridge

__all__ = ["CrazyflieBridge"]
