# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``rotors``."""

from __future__ import annotations

from abc import abstractmethod
from itertools import pairwise

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.simulation.plant import NEVER_NS, DelayedPlant, Measured, odometry_of
from quad_mpc_ros.simulation.rotors import equations, motion, rate_loop
from quad_mpc_ros.simulation.rotors.craft import BodyState, craft_of, put, rotors_of
from quad_mpc_ros.simulation.rotors.mixer import mixing
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters


class RotorsPlant(DelayedPlant):
    """A vehicle of rotors, body, battery and rate loop, commanded by throttle and body rates.

    Throttle and single rotors follow the configured thrust curve.
    """

    follows_rotors = True

    def __init__(self, config: RotorsPlantParameters, *, period_ns: int | None = None) -> None:
        """Set the initial state; ``period_ns`` replaces the period of the rate loop."""
        super().__init__(config)
        if config.motor_count != len(config.rotors.x):
            raise ConfigurationError(
                "simulator.motor_count",
                config.motor_count,
                f"{len(config.rotors.x)}, as many as simulator.rotors.x has",
            )
        self._config = config
        self._craft = craft_of(config, self._vehicle)
        self._rotors = rotors_of(config.rotors, center_B=np.array(config.airframe.center_of_mass))
        self._mix, self._loop = mixing(config.rotors), rate_loop.loop_of(config)
        begin_ns = round(1e9 * config.push.begin)
        lasting_ns = round(1e9 * config.push.duration) or NEVER_NS - begin_ns
        self._push_ns = begin_ns, begin_ns + lasting_ns
        self._inputs = motion.RotorInputs.zeros()
        self._inputs["throttle"] = config.initial_throttle
        self._inputs["w_WB_B"] = config.initial_body_rates
        self._wanted, self._speeds = np.zeros((2, config.motor_count))
        angles = np.arctan2(config.rotors.y, config.rotors.x)
        self._order = np.argsort(angles % (2.0 * np.pi), kind="stable")
        self._body = BodyState.zeros()
        self._memory = rate_loop.begun(np.array(config.initial_body_rates), self._loop)
        self._period_ns = period_ns or round(1e9 / config.rate_loop.rate)
        self._until_loop_ns = 0
        self._start()

    @property
    def state(self) -> State:
        """The true state of the body's origin."""
        measured = self._measured()
        R_WB = so3.rotation_from_quaternion_xyzw(measured["q_WB_xyzw"])
        return State(p_WB=measured["p_WB"], v_WB_B=measured["v_WB_B"], R_WB=R_WB)

    @property
    def v_WB_W(self) -> Array:
        """True velocity of the centre of mass (3,) [m/s]."""
        return np.asarray(self._body["v_WC_W"].copy())

    @property
    def rotor_speeds(self) -> Array:
        """True speeds of the rotors (n,) [rad/s]."""
        return self._speeds.copy()

    @property
    def charge_used(self) -> float:
        """Charge taken from the battery so far [A s]."""
        return float(self._body["charge_used"])

    @property
    def battery_voltage(self) -> float | None:
        """Voltage of the battery [V]; None for a battery with constant voltage."""
        battery = self._config.battery
        if battery.capacity == 0.0:
            return None
        return battery.voltage_full * equations.charge(self._body, self._speeds, self._craft)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry with the given stamp."""
        return odometry_of(self._measured(), self._config, stamp_ns=stamp_ns)

    def _measured(self) -> RecordArray[Measured]:
        measured = Measured.zeros()
        motion.measure(self._body, self._craft, measured)
        return measured

    def _follow(self, command: Input) -> None:
        self._inputs["throttle"], self._inputs["w_WB_B"] = command.throttle, command.w_WB_B

    def _integrate(self, duration_ns: int) -> None:
        self._inputs["wind_W"] = self.wind_W
        end_ns = self.time_ns + duration_ns
        edges = [edge for edge in self._push_ns if self.time_ns < edge < end_ns]
        for from_ns, to_ns in pairwise([self.time_ns, *edges, end_ns]):
            pushed = self._push_ns[0] <= from_ns < self._push_ns[1]
            self._inputs["external_force_W"] = self._config.push.force if pushed else 0.0
            self._move(duration_ns=to_ns - from_ns)

    def _move(self, *, duration_ns: int) -> None:
        """Advance the state over a time with constant external inputs."""
        while duration_ns > 0:
            if self._until_loop_ns == 0:
                self._run_loop()
                self._until_loop_ns = self._period_ns
            until_ns = min(duration_ns, self._until_loop_ns)
            self._coast(until_ns)
            self._until_loop_ns -= until_ns
            duration_ns -= until_ns

    def _run_loop(self) -> None:
        """Run the rate loop on the state of the vehicle, and set the commanded speeds."""
        rate_loop.run(
            self._memory,
            w_WB_B=self._body["w_WB_B"],
            throttle=float(self._inputs["throttle"]),
            rates=self._inputs["w_WB_B"],
            on_ground=self._is_on_ground(),
            loop=self._loop,
            mix=self._mix,
            out=self._wanted,
        )
        if self._rotor_throttles is not None:  # the rate loop runs on, to take over at any time
            loop = self._loop[()]
            thrusts = np.polyval(self._config.thrust_curve, self._rotor_throttles)
            thrusts = thrusts.clip(loop.least, loop.greatest)
            self._wanted[self._order] = np.sqrt(thrusts / loop.thrust_coefficient)

    def _is_on_ground(self) -> bool:
        return motion.is_on_ground(self._body, self._craft)

    def _coast(self, duration_ns: int) -> None:
        """Advance the state over a time with constant commanded speeds."""
        motion.coast(
            self._body,
            speeds=self._speeds,
            wanted=self._wanted,
            inputs=self._inputs,
            craft=self._craft,
            rotors=self._rotors,
            duration_ns=duration_ns,
        )

    def _start(self) -> None:
        """Set the configured initial state, with the rotor speeds of the initial throttle."""
        config, x = self._config, self._body[()]
        R_WB = so3.rotation_from_quaternion_xyzw(config.initial_attitude)
        w_WB_B = np.array(config.initial_body_rates)
        center_B = np.array(config.airframe.center_of_mass)
        x.v_WC_W[:] = config.initial_velocity + R_WB @ np.cross(w_WB_B, center_B)
        x.q_WB_xyzw[:] = so3.quaternion_xyzw_from_rotation(R_WB)
        put(x, kernels.vector(np.array(config.initial_position)), kernels.vector(center_B))
        x.w_WB_B[:] = w_WB_B
        x.charge_used = 3600.0 * config.battery.capacity * (1.0 - config.battery.charge)
        rate_loop.speeds(
            config.initial_throttle,
            torque=(0.0, 0.0, 0.0),
            airmode=True,
            loop=self._loop[()],
            mix=self._mix,
            out=self._wanted,
        )
        self._speeds[:] = self._wanted


class DrivenPlant(RotorsPlant):
    """The plant ``rotors`` with another rate loop, which reads an accelerometer."""

    follows_rotors = False

    @abstractmethod
    def _run_loop(self) -> None:
        """Run the loop on the state of the vehicle, and set the commanded speeds."""

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
