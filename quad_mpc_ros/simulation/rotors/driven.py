"""The plant ``rotors`` under the rate loop and mixer of a real firmware."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant


class DrivenPlant(RotorsPlant):
    """The plant ``rotors`` with another rate loop, which reads an accelerometer."""

    @abstractmethod
    def _run_loop(self) -> None:
        """Run the loop on the state of the vehicle, and set the wanted speeds."""

    def _start(self) -> None:
        super()._start()
        self._v_before_W = self.v_WB_W

    def _specific_force_B(self) -> Array:
        """Return the mean specific force of the last period (3,) [m/s^2]; call once per loop."""
        v_W = self.v_WB_W
        a_W = (v_W - self._v_before_W) / (1e-9 * self._period_ns)
        self._v_before_W = v_W
        R_WB = so3.rotation_from_quaternion_xyzw(self._body["q_WB_xyzw"].copy())
        return np.asarray(R_WB.T @ (a_W + np.array([0.0, 0.0, self._config.gravity])))
