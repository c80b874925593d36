"""The plant ``rotors``."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.simulation.plant import DelayedPlant, odometry_of
from quad_mpc_ros.simulation.rotors import equations, motion, rate_loop
from quad_mpc_ros.simulation.rotors.craft import craft_vector, rotor_rows
from quad_mpc_ros.simulation.rotors.mixer import mixing
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters
from quad_mpc_ros.simulation.rotors.state import Q_WB, SPEEDS, USED, V_WC_W, W_WB_B, put
from quad_mpc_ros.simulation.wind import NEVER_NS


class RotorsPlant(DelayedPlant):
    """A vehicle of rotors, body, battery and rate loop, commanded by throttle and body rates.

    The throttle asks for the thrust of the parameters' curve. Wind, gusts and command delay are
    those of every plant.
    """

    def __init__(self, config: RotorsPlantParameters) -> None:
        super().__init__(config)
        if config.motor_count != len(config.rotors.x):
            raise ConfigurationError(
                "simulator.motor_count",
                config.motor_count,
                f"{len(config.rotors.x)}, as many as simulator.rotors.x has",
            )
        self._config = config
        self._craft = craft_vector(config, self._vehicle)
        self._rotors = rotor_rows(config.rotors, center_B=np.array(config.airframe.center_of_mass))
        self._mix = mixing(config.rotors)
        self._loop = rate_loop.loop_vector(config)
        self._times_ns = np.array(
            [0, 0, round(1e9 / config.rate_loop.rate), round(1e9 * config.integration_step)]
        )
        begin_ns = round(1e9 * config.push.begin)
        lasting_ns = round(1e9 * config.push.duration) or NEVER_NS - begin_ns
        self._push_ns = begin_ns, begin_ns + lasting_ns
        self._inputs = np.zeros(10)
        self._inputs[:4] = config.initial_throttle, *config.initial_body_rates
        self._wanted = np.zeros(config.motor_count)
        self._x = np.zeros(SPEEDS + config.motor_count)
        self._memory = np.zeros(rate_loop.MEMORY_SHAPE)
        self._start()
        # What moves it is compiled or loaded now, not while it flies.
        self._move(duration_ns=0)
        self.odometry(0)

    @property
    def state(self) -> State:
        """The true state of the body's origin."""
        seen = motion.odometry(self._x, self._craft)
        R_WB = so3.rotation_from_quaternion_xyzw(seen[3:7])
        return State(p_WB=seen[0:3], v_WB_B=seen[7:10], R_WB=R_WB)

    @property
    def v_WB_W(self) -> Array:
        """True velocity of the centre of mass (3,) [m/s]."""
        return self._x[V_WC_W].copy()

    @property
    def rotor_speeds(self) -> Array:
        """True speeds of the rotors (n,) [rad/s]."""
        return self._x[SPEEDS:].copy()

    @property
    def charge_used(self) -> float:
        """Charge taken from the battery so far [A s]."""
        return float(self._x[USED])

    @property
    def battery_voltage(self) -> float | None:
        """Voltage of the battery [V]; None of one that never sags."""
        battery = self._config.battery
        if battery.capacity == 0.0:
            return None
        return battery.voltage_full * equations.charge(self._x, self._craft)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        seen = motion.odometry(self._x, self._craft)
        return odometry_of(seen, self._config, stamp_ns=stamp_ns)

    def _follow(self, command: Input) -> None:
        self._inputs[0], self._inputs[1:4] = command.throttle, command.w_WB_B

    def _integrate(self, duration_ns: int) -> None:
        self._inputs[4:7] = self.wind_W
        end_ns = self.time_ns + duration_ns
        edges = [edge for edge in self._push_ns if self.time_ns < edge < end_ns]
        for from_ns, to_ns in pairwise([self.time_ns, *edges, end_ns]):
            pushed = self._push_ns[0] <= from_ns < self._push_ns[1]
            self._inputs[7:10] = self._config.push.force if pushed else 0.0
            self._move(duration_ns=to_ns - from_ns)

    def _move(self, *, duration_ns: int) -> None:
        self._times_ns[0] = duration_ns
        motion.advance(
            self._x,
            memory=self._memory,
            wanted=self._wanted,
            inputs=self._inputs,
            craft=self._craft,
            rotors=self._rotors,
            loop=self._loop,
            mix=self._mix,
            times_ns=self._times_ns,
        )

    def _start(self) -> None:
        """Begin where the parameters say, with rotors that have settled at the throttle."""
        config, x = self._config, self._x
        R_WB = so3.rotation_from_quaternion_xyzw(config.initial_attitude)
        w_WB_B = np.array(config.initial_body_rates)
        center_B = np.array(config.airframe.center_of_mass)
        x[V_WC_W] = config.initial_velocity + R_WB @ np.cross(w_WB_B, center_B)
        x[Q_WB] = so3.quaternion_xyzw_from_rotation(R_WB)
        px, py, pz = config.initial_position
        cx, cy, cz = config.airframe.center_of_mass
        put(x, (px, py, pz), (cx, cy, cz))
        x[W_WB_B] = w_WB_B
        x[USED] = 3600.0 * config.battery.capacity * (1.0 - config.battery.charge)
        rate_loop.begin(self._memory, w_WB_B=w_WB_B, loop=self._loop)
        rate_loop.speeds(
            config.initial_throttle,
            torque=(0.0, 0.0, 0.0),
            airmode=config.rate_loop.airmode,
            loop=self._loop,
            mix=self._mix,
            out=self._wanted,
        )
        x[SPEEDS:] = self._wanted
