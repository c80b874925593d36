# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Your own weights and bounds: smaller position errors or smoother body rates.

Q weights position, velocity and attitude, R weights throttle and body rates. Invalid values are
rejected with the parameter's name and the expected value.
"""

import dataclasses

import numpy as np

from quad_mpc_ros import MpcConfig, simulate, summarise

default = MpcConfig()
configs = {
    "default": default,
    "calm": dataclasses.replace(default, R=(0.0, 0.1, 0.1, 0.1)),
    "slow": dataclasses.replace(default, Q=(1.0,) * 3 + (1.0,) * 3 + (0.01,) * 3),
    "bounded": dataclasses.replace(default, omega_max=(3.0, 3.0, 1.0)),
}

rmse, fastest = {}, {}
print(f"{'weights':10}{'RMSE [m]':>10}{'largest rate [rad/s]':>22}")
for name, mpc in configs.items():
    flight = simulate(mpc, duration=8.0)
    rmse[name] = summarise(flight)["position_rmse_m"]
    fastest[name] = float(np.abs(flight.commands.w_WB_B).max())
    print(f"{name:10}{rmse[name]:10.3f}{fastest[name]:22.2f}")

try:
    dataclasses.replace(default, throttle_max=0.2)
except ValueError as error:
    refusal = str(error)
    print(f"refused: {refusal}")
