# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Resets, live parameters and errors in flight reach every owner of flight state separately."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from fixtures.obstacles import Standing
from fixtures.presets import ideal
from fixtures.windows import window_through
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration.fields import Configuration, ParameterSpec
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.delayed_reference import DelayedReference
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.guide import Avoidance, Guide, Guided
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.mpc import Mpc
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.stage import Stage
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.extras.racing.gates import course_from
from quad_mpc_ros.extras.racing.held_gates import CombinedGuide, HeldGates
from quad_mpc_ros.simulation.config import make_plant

PERIOD_NS = 20_000_000
START_NS = 1_000_000_000
PLACE = np.array([0.0, 0.0, 5.0])
MOVED = EstimateReset(stamp_ns=0, turn=0.0, step_W=np.array([2.0, -1.0, 0.5]))
TURNED = EstimateReset(stamp_ns=0, turn=1.0, step_W=np.array([2.0, -1.0, 0.5]))


class Beside(Guide):
    """Leads half a metre beside the reference, and holds the plan on this side of a plane."""

    def __init__(self) -> None:
        self.reset = EstimateReset(stamp_ns=0, turn=0.0, step_W=np.zeros(3))

    def reset_estimate(self, reset: EstimateReset) -> None:
        self.reset = reset

    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        aside = self.reset.vectors(np.array([0.0, 0.5, 0.0]))
        flown = dataclasses.replace(window, p_WB=window.p_WB + aside)
        normals = np.zeros((12, 8, 3))
        normals[:, 0, 1] = 1.0
        offsets = np.full((12, 8), np.inf)
        offsets[:, 0] = 0.3
        corridor = Corridor(
            stamp_ns=odometry.stamp_ns, step=0.08, normals=normals, offsets=offsets
        )
        return Guided(flown, self.reset.corridor(corridor), Avoidance("around", "as ever"))


class Flight:
    """Windy flight along x, whose odometry is reset before one of its events.

    Attributes:
        events: What each event was: reference, odometry, or watch.
    """

    def __init__(
        self,
        config: MpcConfig | None = None,
        *,
        guide: Guide | None = None,
        reset: EstimateReset | None = None,
        at: int | None = None,
    ) -> None:
        config = config or MpcConfig()
        self.controller = Controller(config, guide=guide)
        lags = "rate_time_constant", "torque_time_constant", "thrust_time_constant"
        as_modelled = {name: getattr(config, name) for name in lags}
        start = {"initial_position": tuple(PLACE), "initial_throttle": 0.35}
        self.plant = make_plant(ideal(as_modelled, **start, wind=(3.0, 1.0, 0.0)))
        self.now_ns = START_NS
        self.events: list[tuple[str, int]] = []
        self.commands: list[Array] = []
        self.ticks: list[Tick] = []
        self.odometry_ns = 0
        self.places: list[Array] = []
        self._reset, self._at = reset, at
        self._coordinates: EstimateReset | None = None

    def fly(self, seconds: float, *, without: str = "") -> None:
        """Fly on, without reference or odometry."""
        for _ in range(round(seconds * 1e9 / PERIOD_NS)):
            self.plant.advance_to(self.now_ns - START_NS)
            self.places.append(self.plant.odometry(self.now_ns).p_WB)
            lockstep = self.controller.config.lockstep
            inputs = ("odometry", "reference") if lockstep else ("reference", "odometry", "watch")
            for event in inputs:
                if event != without:
                    self._happen(event)
            self.now_ns += PERIOD_NS

    def _happen(self, event: str) -> None:
        if self._reset is not None and len(self.events) == self._at:
            begins_ns = self.now_ns + (PERIOD_NS if self.odometry_ns == self.now_ns else 0)
            self._coordinates = dataclasses.replace(self._reset, stamp_ns=begins_ns)
            self.controller.reset_estimate(self._coordinates)
        self.events.append((event, self.now_ns))
        now, tick = self._coordinates, None
        if event == "reference":
            seconds = np.arange(0.0, 1.21, 0.05)
            along = PLACE + np.outer(seconds + 1e-9 * (self.now_ns - START_NS), [1.0, 0.0, 0.0])
            window = window_through(seconds, along, stamp_ns=self.now_ns)
            tick = self.controller.receive_reference(
                window if now is None else now.window(window), now_ns=self.now_ns
            )
        elif event == "odometry":
            odometry, self.odometry_ns = self.plant.odometry(self.now_ns), self.now_ns
            odometry = odometry if now is None else now.odometry(odometry)
            tick = self.controller.receive_odometry(odometry, now_ns=self.now_ns)
        else:
            tick = self.controller.watch(now_ns=self.now_ns)
        if tick is not None:
            self.ticks.append(tick)
            if tick.command is not None:
                self.plant.apply(tick.command)
                self.commands.append(np.array([tick.command.throttle, *tick.command.w_WB_B]))

    def fly_everything(self) -> Flight:
        """Track, lose odometry and get it back, lose the reference and hover."""
        self.fly(0.4)
        self.fly(0.6, without="odometry")
        self.fly(0.3)
        self.fly(1.2, without="reference")
        self.fly(0.2)
        return self


CONFIGURATIONS: dict[str, dict[str, object]] = {
    "manifold": {},
    "contouring": {"formulation": "contouring"},
    "guided": {"obstacles.half_spaces": 8},
}


def flown(name: str, reset: EstimateReset | None = None, at: int | None = None) -> Flight:
    guide = Beside() if name == "guided" else None
    config = MpcConfig().updated(CONFIGURATIONS[name])
    return Flight(config, guide=guide, reset=reset, at=at).fly_everything()


def boundaries(flight: Flight) -> list[int]:
    """Return each kind of event in each part of a flight: a reset comes before one of them."""
    seconds = [1e-9 * (stamp_ns - START_NS) for _, stamp_ns in flight.events]
    parts = [0.3, 0.45, 0.6, 0.9, 1.01, 2.0, 2.51]
    return [int(np.searchsorted(seconds, part)) + k for part in parts for k in range(3)]


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_a_reset_of_the_position_between_any_two_inputs_changes_no_command(name: str) -> None:
    expected = flown(name)
    sources = {tick.decision.source.name for tick in expected.ticks}
    assert sources >= {"MPC", "PLAN", "HOVER", "BLIND"}
    for at in boundaries(expected):
        commands = np.array(flown(name, MOVED, at).commands)
        assert_allclose(commands, expected.commands, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_a_reset_of_the_heading_between_any_two_inputs_does_not_move_the_vehicle(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for the solver's tolerance, for the axes of its problem are turned.

    The limit on iterations is left out: a step that reaches it would stop one linearisation
    sooner or later than the step in other axes.
    """
    monkeypatch.setattr("quad_mpc_ros.control.mpc._MANY_ITERATIONS", 100_000)
    exact = {"advanced.solver.tolerance": 1e-4, "advanced.solver.max_iterations": 20_000}
    monkeypatch.setitem(CONFIGURATIONS, name, CONFIGURATIONS[name] | exact)
    expected = flown(name)
    for at in boundaries(expected)[::4]:
        places = np.array(flown(name, TURNED, at).places)
        assert_allclose(places, expected.places, rtol=0.0, atol=0.001)


def test_a_reset_between_odometry_and_reference_changes_no_command_in_lockstep() -> None:
    config = MpcConfig().updated({**CONFIGURATIONS["guided"], "lockstep": True})
    flights = [Flight(config, guide=Beside(), reset=MOVED, at=at) for at in (None, 40, 41)]
    for flight in flights:
        flight.fly(0.6)
    expected, *moved = (np.array(flight.commands) for flight in flights)
    assert len(expected) == 30
    for commands in moved:
        assert_allclose(commands, expected, rtol=0.0, atol=1e-6)


COURSE = {
    "start": [0.0, 0.0, 2.0],
    "gates": [{"position": [5.0 * k, 0.0, 2.0], "tolerance": 0.4} for k in (1, 2)],
}


def inside(value: Any) -> Iterable[tuple[object, Any]]:
    """Return what a container, a record or an object of the package holds, by name."""
    if isinstance(value, np.ndarray | np.void):
        return [(name, value[name]) for name in value.dtype.names or ()]
    if isinstance(value, Mapping):
        return value.items()
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return zip(value._fields, value, strict=True)
    if isinstance(value, tuple | list | deque):
        return enumerate(value)
    if type(value).__module__.startswith("quad_mpc_ros"):
        return getattr(value, "__dict__", {}).items()
    return ()


def owners_of(value: Any, seen: dict[int, Any]) -> Iterator[Stage]:
    """Yield all stages that can be reached."""
    if id(value) in seen:
        return
    seen[id(value)] = value
    if isinstance(value, Stage):
        yield value
    for _, each in inside(value):
        yield from owners_of(each, seen)


def guided_through_gates() -> Controller:
    guide = CombinedGuide(
        ObstacleAvoidance(MpcConfig(), Standing(), radius=0.2),
        HeldGates(course_from(COURSE), radius=0.2),
    )
    return Controller(MpcConfig(), guide=guide)


def test_every_owner_of_flight_state_is_a_stage_of_the_controller() -> None:
    controller = guided_through_gates()
    found = sorted(type(each).__name__ for each in owners_of(controller, {}))
    assert found == sorted(type(each).__name__ for each in controller.stages)
    assert {"HeldGates", "ObstacleAvoidance", "HoverFallback", "OdometryGate"} <= set(found)


# --- live parameters


LIVE = [spec for spec in MpcConfig.specs() if spec.live]
LIMITS = {"limits.speed_max": 5.0}
OTHER: dict[str, object] = {"throttle_min": 0.05}


def changed(config: MpcConfig, spec: ParameterSpec) -> MpcConfig:
    """Return a configuration with another value of a parameter."""
    value = config.flattened()[spec.name]
    if spec.path in OTHER:
        value = OTHER[spec.path]
    elif spec.choices is not None:
        value = next(choice for choice in spec.choices if choice != value)
    elif isinstance(value, tuple):
        value = tuple(0.8 * each for each in value)
    else:
        value = 0.9 * value if value else 0.5
    return config.updated({spec.name: value})


def values_of(value: Any, path: str = "", seen: dict[int, Any] | None = None) -> dict[str, Any]:
    """Return all plain values that can be reached, by their path."""
    seen = {} if seen is None else seen
    plain = value is None or isinstance(value, int | float | str | bytes | Configuration)
    if plain or (isinstance(value, np.generic) and not isinstance(value, np.void)):
        return {path: repr(value)}
    if isinstance(value, np.ndarray) and not value.dtype.names:
        return {path: value.tobytes()}
    if id(value) in seen:
        return {}
    seen[id(value)] = value
    found: dict[str, Any] = {}
    for name, each in inside(value):
        found |= values_of(each, f"{path}.{name}", seen)
    return found


def flight_of(formulation: str) -> Flight:
    config = MpcConfig().updated({"formulation": formulation, **LIMITS})
    guide = ObstacleAvoidance(config, Standing(), radius=config.radius)
    return Flight(config, guide=guide)


@pytest.mark.parametrize("spec", LIVE, ids=lambda spec: spec.path)
@pytest.mark.parametrize("formulation", ["contouring", "paper"])
def test_a_live_parameter_changes_everything_that_depends_on_it(
    formulation: str, spec: ParameterSpec
) -> None:
    """A change in flight has the effect of a new controller, and nothing else changes."""
    new, flight = flight_of(formulation).controller, flight_of(formulation)
    flight.fly(0.1)
    before = new.config
    after = changed(before, spec)
    unchanged, expected = values_of(flight.controller), values_of(new)
    flown = dict(unchanged)
    guide = ObstacleAvoidance(after, Standing(), radius=after.radius)
    for path, value in values_of(Controller(after, guide=guide)).items():
        if expected[path] != value:
            flown[path] = value
    assert flown != unchanged
    flight.controller.reconfigure(after)
    assert values_of(flight.controller) == flown
    flight.controller.reconfigure(before)
    assert values_of(flight.controller) == unchanged


# --- engagement


def test_hovers_at_the_engagement_position_after_manual_flight() -> None:
    """The reference is lost, so that the fallback holds the place where it was engaged before."""
    flight = Flight()
    flight.fly(0.3)
    flight.fly(1.2, without="reference")
    assert flight.ticks[-1].stats.source == "hover"
    flight.controller.engage(False)
    now_ns = flight.now_ns
    for _ in range(10):
        now_ns += PERIOD_NS
        away = OdometrySample.at_rest([40.0, 0.0, 5.0], stamp_ns=now_ns)
        flight.controller.receive_odometry(away, now_ns=now_ns)
    flight.controller.engage(True)
    away = OdometrySample.at_rest([40.0, 0.0, 5.0], stamp_ns=now_ns + PERIOD_NS)
    tick = flight.controller.receive_odometry(away, now_ns=now_ns + PERIOD_NS)
    assert tick is not None and tick.command is not None
    assert tick.stats.source == "hover"
    assert np.abs(tick.command.w_WB_B).max() < 0.7, "at 40 m it would tilt as fast as it may"


def test_manual_flight_does_not_delay_the_reference() -> None:
    """Contouring gives time up for a vehicle that does not follow."""
    config = MpcConfig().updated({"formulation": "contouring"})
    controller = Controller(config)

    def stand(ticks: int, now_ns: int) -> Tick:
        for k in range(ticks):
            stamp_ns = now_ns + k * PERIOD_NS
            seconds = np.arange(0.0, 2.01, 0.05)
            along = PLACE + np.outer(seconds + 1e-9 * stamp_ns, [3.0, 0.0, 0.0])
            window = window_through(seconds, along, stamp_ns=stamp_ns)
            controller.receive_reference(window, now_ns=stamp_ns)
            odometry = OdometrySample.at_rest(PLACE, stamp_ns=stamp_ns)
            tick = controller.receive_odometry(odometry, now_ns=stamp_ns)
        assert tick is not None
        return tick

    assert stand(50, START_NS).stats.progress_delay_s > 0.1
    controller.engage(False)
    assert stand(50, START_NS + 50 * PERIOD_NS).stats.progress_delay_s == 0.0
    controller.engage(True)
    assert stand(1, START_NS + 100 * PERIOD_NS).stats.progress_delay_s == 0.0


# --- errors


STAGES: dict[str, tuple[type, str]] = {
    "ground detector": (GroundDetector, "update"),
    "estimator": (DelayCompensation, "predict"),
    "record of commands": (DelayCompensation, "record"),
    "delayed reference": (DelayedReference, "at"),
    "guide": (Beside, "guide"),
    "MPC": (Mpc, "solve"),
}


def failing(owner: type, name: str, ticks: Iterable[int]) -> Callable[..., Any]:
    """Return a method that raises in its calls with these numbers."""
    count, method = itertools.count(), getattr(owner, name)

    def replaced(*arguments: Any, **named: Any) -> Any:
        if next(count) in ticks:
            raise ArithmeticError("of nothing")
        return method(*arguments, **named)

    return replaced


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("name", ["guided", "contouring"])
def test_an_error_in_a_stage_is_reported_and_does_not_stop_other_stages(
    name: str, stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if (name, stage) == ("contouring", "guide"):
        pytest.skip("flies without a guide")
    guide = Beside() if name == "guided" else None
    flight = Flight(MpcConfig().updated(CONFIGURATIONS[name]), guide=guide)
    flight.fly(4.0)
    learned, thrust_scale = flight.ticks[-1].stats, flight.ticks[-1].stats.thrust_scale
    assert learned.disturbance_x > 0.3
    owner, method = STAGES[stage]
    monkeypatch.setattr(owner, method, failing(owner, method, [0, 3]))
    flight.fly(0.02)
    failed = flight.ticks[-1]
    warnings = flight.controller.take_warnings()
    reason = f"error in the {stage}: ArithmeticError('of nothing')"
    if stage == "MPC":
        assert failed.stats.reason == reason
        assert (failed.stats.solver_failures, failed.stats.stage_errors) == (1, 0)
    else:
        assert warnings == [reason]
        assert (failed.stats.solver_failures, failed.stats.stage_errors) == (0, 1)
    assert failed.stats.source == ("plan" if stage in ("MPC", "estimator") else "mpc")
    if stage == "guide":
        assert failed.guided is not None and failed.guided.corridor is None
        assert (failed.stats.avoidance, failed.stats.avoidance_reason) == ("failed", reason)
    flight.fly(0.2)
    after = flight.ticks[-1].stats
    assert after.source == "mpc"
    assert after.avoidance == ("around" if guide else "off")
    assert after.thrust_scale == pytest.approx(thrust_scale, abs=0.01)
    assert after.disturbance_x == pytest.approx(learned.disturbance_x, abs=0.05)
    assert after.estimate_resets == 0


def test_failing_guide_gives_the_commands_without_a_guide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Beside, "guide", failing(Beside, "guide", range(10_000)))
    config = MpcConfig().updated(CONFIGURATIONS["guided"])
    failing_guide, none = (Flight(config, guide=guide) for guide in (Beside(), None))
    for flight in (failing_guide, none):
        flight.fly_everything()
    assert np.array_equal(failing_guide.commands, none.commands)
    assert failing_guide.ticks[-1].stats.solver_failures == 0


@pytest.mark.parametrize(
    "event",
    [
        lambda controller: controller.reset_estimate(MOVED),
        lambda controller: controller.reconfigure(controller.config.updated({"mass": 0.5})),
        lambda controller: controller.engage(False),
    ],
    ids=["reset_estimate", "reconfigure", "engage"],
)
def test_events_reach_all_stages_although_one_raises(
    event: Callable[[Controller], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("reset_estimate", "reconfigure", "engage")
    config = MpcConfig().updated(CONFIGURATIONS["guided"])
    sound, failing_guide = Flight(config, guide=Beside()), Flight(config, guide=Beside())
    for flight in (sound, failing_guide):
        flight.fly(0.1)
        flight.controller.take_warnings()
    event(sound.controller)
    for name in names:
        monkeypatch.setattr(Beside, name, failing(Beside, name, range(10)))
    event(failing_guide.controller)
    warnings = failing_guide.controller.take_warnings()
    assert warnings == ["error in the Beside: ArithmeticError('of nothing')"]
    differing = {
        path: value
        for path, value in values_of(sound.controller).items()
        if values_of(failing_guide.controller)[path] != value
    }
    # Times of the solver differ in any two flights.
    times = re.compile(r"\._last_tick\.step\.(solution\.)?(solve|step)_time")
    assert all(
        ".guide." in path or path.startswith("._log.counts") or times.fullmatch(path)
        for path in differing
    )


def test_failing_gates_do_not_disable_obstacle_avoidance(monkeypatch: pytest.MonkeyPatch) -> None:
    gates = HeldGates(course_from(COURSE), radius=0.2)
    guide = CombinedGuide(Beside(), gates)
    odometry = OdometrySample.at_rest(PLACE)
    window = ReferenceWindow.hover(PLACE)
    monkeypatch.setattr(HeldGates, "guide", failing(HeldGates, "guide", range(10)))
    guided = guide.guide(odometry, window, None)
    assert guided.corridor is not None
    assert_allclose(guided.window.p_WB, window.p_WB + np.array([0.0, 0.5, 0.0]))
    assert guided.avoidance.state == "around"
    assert "of nothing" in guided.avoidance.reason
