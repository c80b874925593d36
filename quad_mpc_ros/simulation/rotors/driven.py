"""Rotors and body under the rate loop and mixer of a real firmware."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.simulation.rotors import motion
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant


class DrivenPlant(RotorsPlant):
    """The plant ``rotors`` with another rate loop, run once a period."""

    def __init__(self, config: RotorsPlantParameters, *, period_ns: int) -> None:
        self._period_ns = period_ns
        self._until_loop_ns = 0
        super().__init__(config)

    @abstractmethod
    def _run_loop(self) -> None:
        """Run the loop on the state of the vehicle, and set the wanted speeds."""

    def _start(self) -> None:
        super()._start()
        self._v_before_W = self.v_WB_W

    def _move(self, *, duration_ns: int) -> None:
        while duration_ns > 0:
            if self._until_loop_ns == 0:
                self._run_loop()
                self._until_loop_ns = self._period_ns
            until_ns = min(duration_ns, self._until_loop_ns)
            self._coast(until_ns)
            self._until_loop_ns -= until_ns
            duration_ns -= until_ns

    def _coast(self, duration_ns: int) -> None:
        motion.coast(
            self._body,
            speeds=self._speeds,
            wanted=self._wanted,
            inputs=self._inputs,
            craft=self._craft,
            rotors=self._rotors,
            duration_ns=duration_ns,
        )

    def _specific_force_B(self) -> Array:
        """Return the mean specific force of the last period (3,) [m/s^2]; call once per loop."""
        v_W = self.v_WB_W
        a_W = (v_W - self._v_before_W) / (1e-9 * self._period_ns)
        self._v_before_W = v_W
        R_WB = so3.rotation_from_quaternion_xyzw(self._body["q_WB_xyzw"].copy())
        return np.asarray(R_WB.T @ (a_W + np.array([0.0, 0.0, self._config.gravity])))
