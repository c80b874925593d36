# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The factor on the weights of the rates in the MPC: small for a known rate loop, large if unsure.

The configured weights suit an unknown latency. The factor follows the uncertainty of the estimated
latency of roll and pitch, slowly while it falls. Rates that the estimated loop does not explain
raise the factor at once.
"""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation.filter_state import (
    RATES,
    ROLL_PITCH,
    Filter,
    loop_lags,
)
from quad_mpc_ros.control.estimation.loop_rates import unexplained
from quad_mpc_ros.control.model.vehicle import LATENCY_UNCERTAINTY

# Increase of the factor per unexplained share of the measured rates above the usual.
_CAUTION, _USUAL = 8.0, 0.08
_LEAST_UNCERTAINTY = 0.25  # of an estimated latency, as no loop is exactly of second order
_FALL_TIME, _RISE_TIME = 2.0, 0.3  # s


@compiled
def rate_weight_scale(state: Filter) -> float:
    """Return the factor on the weights of the rates."""
    return state.known_loop_scale + _CAUTION * max(unexplained(state.loop) - _USUAL, 0.0)


@compiled
def start_rate_weights(state: Filter) -> None:
    """Start with the factor of the uncertainty that is known before the flight."""
    state.known_loop_scale = state.latency_uncertainty / LATENCY_UNCERTAINTY[1]


@compiled
def update_rate_weights(state: Filter, duration: float) -> None:
    """Follow the uncertainty of the latency for a duration [s].

    A vehicle whose rates are not explained is no longer the identified vehicle.
    """
    most, explained = LATENCY_UNCERTAINTY[1], unexplained(state.loop) <= _USUAL
    share = -math.expm1(-duration / (_FALL_TIME if explained else _RISE_TIME))
    if explained:
        uncertainty = min(_latency_uncertainty(state), state.latency_uncertainty)
    else:
        state.latency_uncertainty += share * (most - state.latency_uncertainty)
        uncertainty = state.latency_uncertainty
    state.known_loop_scale += share * (uncertainty / most - state.known_loop_scale)


@compiled
def _latency_uncertainty(state: Filter) -> float:
    """Return half the 95 % interval of tau + T of roll and pitch [s]."""
    (rate, torque), P = loop_lags(state, ROLL_PITCH), state.rates.P
    i, j = RATES.lag + ROLL_PITCH, RATES.torque_lag + ROLL_PITCH
    variance = rate**2 * P[i, i] + torque**2 * P[j, j] + 2.0 * rate * torque * P[i, j]
    return max(2.0 * math.sqrt(max(variance, 0.0)), _LEAST_UNCERTAINTY * (rate + torque))
