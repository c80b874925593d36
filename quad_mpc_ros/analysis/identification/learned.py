"""What the controller has estimated of its vehicle in flight, from the figures of its ticks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.identification import vehicle_file
from quad_mpc_ros.analysis.identification.result import ParameterEstimate
from quad_mpc_ros.configuration import UserError, per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.error_state import SCALE_BOUNDS
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.tick import TickStats

_MIN_TICKS = 25
_MAX_SPREAD = 0.1  # of a value, either way
_MAX_DRIFT = 0.01  # of the thrust, from the median of one half of the ticks to the other's
_AT_BOUND = 0.005
_MIN_YAW_CHANGE = 0.1  # of a time constant; a smaller change is hardly observable
_MIN_DRAG_CHANGE = 0.01  # 1/s; at rest it stays as it is given
_TAUS = tuple(f"{lag}_time_constant" for lag in ("rate", "yaw", "torque", "thrust"))


@dataclass(frozen=True, kw_only=True)
class FlightEstimates:
    """The estimates over some ticks: their medians and their spread.

    Time constants [s] are None where the model has no lag, of which nothing is estimated; those of
    the rates and of the torque are the means of roll and pitch. ``drag`` [1/s] is the mean over
    the axes, None where it is as it was given or has not settled: it is learned in motion only.
    """

    thrust_scale: ParameterEstimate
    rate_time_constant: ParameterEstimate | None
    yaw_time_constant: ParameterEstimate | None
    torque_time_constant: ParameterEstimate | None
    thrust_time_constant: ParameterEstimate | None
    drag: ParameterEstimate | None
    ticks: int


def learned(ticks: Sequence[TickStats], given: MpcConfig) -> FlightEstimates:
    """Return the estimates over ticks of the flying MPC. Raises :class:`UserError` for none.

    ``given`` is the configuration that it flies with.
    """
    if not given.on_manifold or not given.estimate_disturbance:
        raise UserError(
            "the MPC estimates nothing: expected formulation manifold and estimate_disturbance "
            f"true, given {given.formulation} and {str(given.estimate_disturbance).lower()}"
        )
    flying = [tick for tick in ticks if tick.source == "mpc"]
    if len(flying) < _MIN_TICKS:
        reason = f" (the last: {ticks[-1].source}, {ticks[-1].reason})" if ticks else ""
        raise UserError(
            f"the MPC flew {len(flying)} ticks while it was watched{reason}, expected "
            f"{_MIN_TICKS} or more"
        )
    estimated = np.array([tick.thrust_scale for tick in flying])
    scale = _estimate(_thrust_scales(flying, given), max_drift=_MAX_DRIFT)
    _check(scale, estimated=float(np.median(estimated)))
    times = {name: np.array([getattr(tick, f"{name}_ms") for tick in flying]) for name in _TAUS}
    lags = {name: _estimate(1e-3 * time) if time.any() else None for name, time in times.items()}
    return FlightEstimates(
        thrust_scale=scale, drag=_drag(flying, given), ticks=len(flying), **lags
    )


def learned_file(
    found: FlightEstimates,
    given: MpcConfig,
    *,
    head: str,
    keep: vehicle_file.Kept,
    bridge: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """Return the vehicle file with what was learned in it.

    ``head`` is its first line, a remark; ``bridge`` are the parameters of the bridge that flies,
    of which the file has the thrust map. Raises ``ConfigurationError`` when the controller would
    refuse the values.
    """
    entries = vehicle_file.thrust_entries(found.thrust_scale, given, keep=keep)
    entries["rate_time_constant"] = _lag_entry(
        found.rate_time_constant, found.yaw_time_constant, given.rate_time_constant
    )
    entries["torque_time_constant"] = _lag_entry(
        found.torque_time_constant, None, given.torque_time_constant
    )
    if found.thrust_time_constant is not None:
        entries["thrust_time_constant"] = vehicle_file.found_entry(found.thrust_time_constant)
    if found.drag is not None:
        entries["drag"] = _drag_entry(found.drag, given)
    scale = found.thrust_scale.value if keep == "mass" else 1.0
    thrust_map = vehicle_file.map_entries(bridge, scale)
    return vehicle_file.content(entries, given, remarks=[head], thrust_map=thrust_map)


def _drag(ticks: Sequence[TickStats], given: MpcConfig) -> ParameterEstimate | None:
    drag = _estimate(np.array([tick.drag for tick in ticks]))
    moved = abs(drag.value - float(np.mean(per_axis(given.drag)))) > _MIN_DRAG_CHANGE
    return drag if drag.observable and moved and drag.value > 0.0 else None


def _drag_entry(found: ParameterEstimate, given: MpcConfig) -> tuple[Any, str]:
    """Return the drag of each axis: they keep their proportions."""
    if isinstance(given.drag, float):
        return vehicle_file.found_entry(found)
    mean = float(np.mean(given.drag))
    shares = [drag / mean if mean > 0.0 else 1.0 for drag in given.drag]
    return vehicle_file.axes_entry([_scaled(found, share) for share in shares], given.drag)


def _lag_entry(
    shared: ParameterEstimate | None,
    of_yaw: ParameterEstimate | None,
    given: float | tuple[float, ...],
) -> tuple[Any, str]:
    """Return the lags of the axes: one number, unless yaw's is another or three are given.

    Roll and pitch have the ``shared`` lag and keep their ratio.
    """
    roll, pitch, yaw = per_axis(given)
    apart = of_yaw is not None and all(
        abs(of_yaw.value - other) > _MIN_YAW_CHANGE * other
        for other in (yaw, yaw if shared is None else shared.value)
    )
    if isinstance(given, float) and not apart:
        return (given, vehicle_file.KEPT) if shared is None else vehicle_file.found_entry(shared)
    shares = [2.0 * lag / ((roll + pitch) or 1.0) for lag in (roll, pitch)]
    of_axes = [None if shared is None else _scaled(shared, share) for share in shares]
    return vehicle_file.axes_entry([*of_axes, of_yaw], given)


def _scaled(estimate: ParameterEstimate, factor: float) -> ParameterEstimate:
    return dataclasses.replace(
        estimate, value=factor * estimate.value, half_width=factor * estimate.half_width
    )


def _thrust_scales(ticks: Sequence[TickStats], given: MpcConfig) -> Array:
    """Return the scales that carry the vehicle without a vertical disturbance.

    In a hover a lack of thrust and a steady push look alike, and the estimator assigns some to
    each: ``thrust_scale`` T/m + d = g. Little pushes a vehicle up or down for long, so all of it
    is taken for thrust.
    """
    scales = np.array([tick.thrust_scale for tick in ticks])
    pushes = np.array([tick.disturbance_z for tick in ticks])
    return np.asarray(scales * given.gravity / (given.gravity - pushes))


def _check(scale: ParameterEstimate, *, estimated: float) -> None:
    if scale.value == 1.0 and scale.half_width == 0.0:
        raise UserError(
            "nothing has been learned yet: thrust_scale in mpc/stats is 1 throughout; fly first"
        )
    low, high = SCALE_BOUNDS
    if not low + _AT_BOUND < estimated < high - _AT_BOUND:
        raise UserError(
            f"thrust_scale {estimated:.3f} is at the end of what is estimated, {low:g} to "
            f"{high:g}: correct mass or thrust_curve by about that much and fly again"
        )
    if not scale.observable:
        raise UserError(
            f"the thrust has not settled: {scale.value:.3f} +- {scale.half_width:.2g} of the "
            "given, expected +- 10 % and a drift of 1 % or less: fly longer, or more calmly"
        )


def _estimate(values: Array, *, max_drift: float = _MAX_SPREAD) -> ParameterEstimate:
    low, middle, high = np.percentile(values, (2.5, 50.0, 97.5)).tolist()
    half_width = 0.5 * (high - low)
    first, second = np.array_split(values, 2)
    drift = abs(np.median(second) - np.median(first))
    return ParameterEstimate(
        value=middle,
        half_width=half_width,
        seen=True,
        observable=bool(half_width <= _MAX_SPREAD * abs(middle) and drift <= max_drift * middle),
    )
