"""Calls of the library with generated wrong arguments, each judged: a program and its parts.

    python -P test/face/wrong_calls.py COUNT [SEED]

Ends with 0 if nothing crashed, every refusal is an :class:`ArgumentError` or another documented
error that names what it is about, and a controller that refused steps as one never abused.
"""

from __future__ import annotations

import inspect
import random
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros import (
    CommandSample,
    Controller,
    Flight,
    MpcConfig,
    OdometrySample,
    Recording,
    ReferenceConfig,
    ReferenceWindow,
    SimulatorConfig,
    Vehicle,
    identify,
    load_config,
    simulate,
    so3,
    summarise,
)
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.model.estimate_reset import EstimateReset


class Call(NamedTuple):
    """A call that is good, of which one argument or more is made wrong."""

    function: Callable[..., Any]
    arguments: dict[str, Any]


class Wrong:
    """Makes arguments that are mostly wrong, from a seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self._numbers = np.random.default_rng(seed)

    def like(self, good: Any) -> Any:
        """Return something wrong, now and then made of what would have been right."""
        if isinstance(good, np.ndarray) and self.random.random() < 0.6:
            return self.random.choice(self._ways(good))()
        return self.random.choice(self._anything)()

    def _ways(self, good: np.ndarray[Any, Any]) -> list[Callable[[], Any]]:
        return [
            lambda: good[:-1],
            lambda: good[:0],
            lambda: np.concatenate((good, good)),
            lambda: good[None],
            lambda: good.astype(complex),
            lambda: good.astype(object),
            lambda: good.astype(str),
            lambda: good.astype(np.float32),
            lambda: np.repeat(good, 2, axis=-1)[..., ::2],
            lambda: self._frozen(good),
            lambda: np.full_like(good, np.nan, dtype=float),
            lambda: np.full_like(good, np.inf, dtype=float),
            lambda: good * 1e300,
            lambda: -good,
            lambda: good.tolist(),
            lambda: good[..., 0],
            lambda: np.asfortranarray(np.tile(good, (2, 1))),
            lambda: np.broadcast_to(good[:1], good.shape),
            lambda: [good.tolist(), 1.0],
            lambda: np.ma.masked_array(good, mask=True),
            lambda: good.tobytes(),
            lambda: good.astype(">f8"),
        ]

    @property
    def _anything(self) -> list[Callable[[], Any]]:
        return [
            lambda: None,
            lambda: "three",
            lambda: b"three",
            lambda: float("nan"),
            lambda: float("inf"),
            lambda: -1.0,
            lambda: 10**400,
            lambda: 10**5000,
            lambda: -(2**63),
            lambda: 2**62,
            lambda: 0,
            lambda: True,
            lambda: 1e308,
            lambda: 3 + 4j,
            lambda: Fraction(1, 3),
            list,
            lambda: [[1.0, 2.0], [3.0]],
            lambda: {"x": 1.0},
            lambda: {1.0, 2.0},
            lambda: object(),
            lambda: type,
            lambda: np.zeros(0),
            lambda: np.zeros((3, 0)),
            lambda: np.array(1.0),
            lambda: np.array("text"),
            lambda: np.array([None, 1.0, "x"], dtype=object),
            lambda: np.zeros(2),
            lambda: np.zeros(3),
            lambda: np.zeros(6),
            lambda: np.zeros((3, 3)),
            lambda: np.datetime64("2020-01-01"),
            lambda: np.int8(3),
            lambda: self._numbers.normal(size=(2, 3, 3)),
            lambda: self._numbers.normal(size=tuple(self._numbers.integers(0, 5, size=2))),
            lambda: (element for element in (1.0, 2.0, 3.0)),
            lambda: lambda *_: None,
            lambda: Path("/nowhere/at/all"),
            lambda: MpcConfig,
            lambda: OdometrySample.at_rest([0.0, 0.0, 1.0]),
        ]

    @staticmethod
    def _frozen(good: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        copy = good.copy()
        copy.flags.writeable = False
        return copy


def good_calls(controller: Controller, flight: Flight) -> list[Call]:
    """Return a good call of each name of the face, and of its methods."""
    p, q, zero = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    odometry, window = OdometrySample.at_rest(p, stamp_ns=1), ReferenceWindow.hover(p)
    command = CommandSample(stamp_ns=1, throttle=0.3, w_WB_B=zero)
    rows, vehicle = np.tile(p, (2, 1)), MpcConfig().vehicle()
    motion: dict[str, Any] = {"p_WB": p, "q_WB_xyzw": q, "v_WB_B": zero, "w_WB_B": zero}
    samples = dict.fromkeys(("p_WB", "v_WB_W", "a_WB_W", "w_WB_W"), rows)
    seconds, through = np.arange(4.0), np.tile(p, (4, 1))
    both = {"odometry": odometry, "reference": window}
    eye, now = np.eye(3), {"now_ns": 1}
    reset = EstimateReset(stamp_ns=0, turn=0.0, step_W=zero)
    fields = {name: getattr(flight, name) for name in Flight.__dataclass_fields__}
    return [
        Call(OdometrySample, {"stamp_ns": 1, "frame_id": "odom", "v_variance": 0.0, **motion}),
        Call(OdometrySample.at_rest, {"p_WB": p, "yaw": 0.0, "stamp_ns": 1}),
        Call(CommandSample, {"stamp_ns": 1, "throttle": 0.3, "w_WB_B": zero}),
        Call(
            ReferenceWindow,
            {
                "stamp_ns": 1,
                "offset_ns": np.array([0, 10**9]),
                "q_WB_xyzw": np.tile(q, (2, 1)),
                **samples,
            },
        ),
        Call(ReferenceWindow.hover, {"p_WB": p, "yaw": 0.0, "duration": 2.0, "stamp_ns": 1}),
        Call(
            ReferenceWindow.through,
            {"seconds": seconds, "p_WB": through, "yaw": 0.0, "gravity": 9.81},
        ),
        Call(window.pose_at, {"stamp_ns": 1}),
        Call(EstimateReset, {"stamp_ns": 1, "turn": 0.0, "step_W": zero}),
        Call(MpcConfig, {"horizon_steps": 10, "fence": MpcConfig().fence, "mass": 0.4}),
        Call(MpcConfig.build, {"values": {"horizon_steps": 10}}),
        Call(MpcConfig().updated, {"changes": {"fence.minimum": [-1.0, -1.0, 0.0]}}),
        Call(SimulatorConfig, {"duration": 1.0, "initial_position": (0.0, 0.0, 0.0)}),
        Call(ReferenceConfig, {"trajectory": "hover", "height": 1.0}),
        Call(Vehicle, {"mass": 0.4, "thrust_curve": (1.9, 2.8, 0.0)}),
        Call(vehicle.thrust, {"throttle": 0.3}),
        Call(vehicle.throttle_for, {"thrust": 3.0}),
        Call(vehicle.nearest_throttle, {"thrust": 3.0}),
        Call(
            vehicle.specific_thrust,
            {"a_WB_W": rows, "v_WB_W": rows, "R_WB": np.tile(np.eye(3), (2, 1, 1))},
        ),
        Call(Controller, {"config": MpcConfig(), "deadline": 1.0}),
        *[Call(controller.step, both)] * 4,
        Call(controller.receive_odometry, {"odometry": odometry, **now}),
        Call(controller.receive_reference, {"window": window, **now}),
        Call(controller.watch, now),
        Call(controller.seconds_until_unseen, now),
        Call(controller.engage, {"engaged": True}),
        Call(controller.landed, {"landed": None}),
        Call(controller.reconfigure, {"config": controller.config}),
        Call(controller.reset_estimate, {"reset": reset}),
        Call(controller.check_stamps, {"wanted": True}),
        Call(controller.replace_last_command, {"command": command, **now}),
        Call(simulate, {"mpc": None, "simulator": None, "reference": None, "duration": 0.04}),
        Call(simulate, {"duration": 0.04, "plant": None, "trajectory": None, "controller": None}),
        Call(load_config, {"assignments": ["mpc.horizon_steps=10"]}),
        Call(summarise, {"flight": flight, "wall_seconds": 1.0}),
        Call(Flight, fields),
        Call(Recording, {"path": "/nowhere"}),
        Call(identify, {"recording": None}),
        Call(so3.exp, {"phi": p}),
        Call(so3.hat, {"phi": p}),
        Call(so3.vee, {"skew": np.zeros((3, 3))}),
        Call(so3.cross, {"a": p, "b": p}),
        Call(so3.log, {"rotation": eye}),
        Call(so3.right_jacobian, {"phi": p}),
        Call(so3.right_jacobian_inverse, {"phi": p}),
        Call(so3.shortest_rotation, {"start": rows, "end": rows}),
        Call(so3.shortest_turn_of_z, {"direction": p}),
        Call(so3.rotation_from_quaternion_xyzw, {"q_xyzw": q}),
        Call(so3.quaternion_xyzw_from_rotation, {"rotation": eye}),
    ]


def run(count: int, seed: int) -> tuple[list[str], Counter[str]]:
    """Return what was wrong with the refusals, and how often what was the outcome."""
    wrong, faults, outcomes = Wrong(seed), list[str](), Counter[str]()
    flight = simulate(duration=0.04)
    abused, calm = Controller(MpcConfig()), Controller(MpcConfig())
    victim, stamp_ns = Controller(MpcConfig()), 0
    for k in range(count):
        if k % 100 == 0:
            victim = Controller(MpcConfig())
        call = wrong.random.choice(good_calls(victim, flight))
        names = [name for name in call.arguments if wrong.random.random() < 0.4]
        names = names or [wrong.random.choice(list(call.arguments))]
        arguments = {
            name: wrong.like(good) if name in names else good
            for name, good in call.arguments.items()
        }
        outcome = outcome_of(Call(call.function, arguments), names)
        outcomes[outcome.split(":")[0]] += 1
        if outcome.startswith("fault"):
            faults.append(f"{call.function.__qualname__}({names}): {outcome}")
        abuse(abused, wrong)
        if k % 10 == 0:
            stamp_ns += 20_000_000
            if not same_step(abused, calm, stamp_ns):
                faults.append(f"after call {k} a good step gives another command")
    return faults, outcomes


def outcome_of(call: Call, names: list[str]) -> str:
    """Return accepted, refused, or the fault of a refusal."""
    try:
        call.function(**call.arguments)
    except UserError as error:
        text = str(error)
        if "\n" in text:
            return f"fault: not one sentence: {text[:200]!r}"
        named = any(name in text for name in (*names, *inner_names(call.function)))
        return "refused" if named else f"fault: names no argument: {text}"
    except Exception as error:
        return f"fault: {type(error).__name__}: {error}"
    return "accepted"


def inner_names(function: Callable[..., Any]) -> list[str]:
    """Return what a message may name in place of the argument: a node's parameter, a path."""
    owner = getattr(function, "owner", "") or getattr(
        getattr(function, "__self__", None), "owner", ""
    )
    inside = {
        simulate: ["simulator.", "reference.", "mpc."],
        load_config: ["mpc."],
        Recording: ["does not exist", "bag"],
        ReferenceWindow.through: ["seconds", "p_WB"],
        so3.shortest_rotation: ["start", "end"],
    }
    parameters = [name for name in inspect.signature(function).parameters if len(name) > 3]
    return [*([f"{owner}"] if owner else []), *inside.get(function, []), *parameters]


def abuse(controller: Any, wrong: Wrong) -> None:
    """Call a controller wrongly: each call is refused with an error and must change nothing."""
    bad: Any = wrong.random.choice([None, "x", 3, [], np.zeros(3), object()])
    methods: list[Callable[[], Any]] = [
        lambda: controller.step(bad, bad),
        lambda: controller.step(OdometrySample.at_rest([0.0, 0.0, 1.0]), bad),
        lambda: controller.step(bad, ReferenceWindow.hover([0.0, 0.0, 9.0])),
        lambda: controller.engage(bad if bad is not None else 1),
        lambda: controller.landed(bad if bad is not None else 1),
        lambda: controller.reconfigure(bad),
        lambda: controller.reset_estimate(bad),
        lambda: controller.check_stamps(bad),
        lambda: controller.replace_last_command(bad, now_ns=0),
        lambda: controller.receive_odometry(bad, now_ns=0),
        lambda: controller.receive_reference(bad, now_ns=0),
        lambda: controller.watch(now_ns="now"),
    ]
    try:
        wrong.random.choice(methods)()
    except UserError:
        return
    raise AssertionError(f"accepted: {bad!r}")


def same_step(one: Controller, other: Controller, stamp_ns: int) -> bool:
    """Whether two controllers answer the same odometry by the same command, bit for bit."""
    odometry = OdometrySample.at_rest([0.0, 0.1, 1.0], stamp_ns=stamp_ns)
    window = ReferenceWindow.hover([0.0, 0.0, 2.0], stamp_ns=stamp_ns)
    ticks = [controller.step(odometry, window) for controller in (one, other)]
    commands = [tick.command for tick in ticks if tick is not None]
    assert len(commands) == 2
    return all(command is not None for command in commands) and (
        commands[0].throttle == commands[1].throttle  # type: ignore[union-attr]
        and commands[0].w_WB_B.tobytes() == commands[1].w_WB_B.tobytes()  # type: ignore[union-attr]
    )


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    found, seen = run(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    print(dict(seen))
    print("\n".join(found[:40]))
    sys.exit(1 if found else 0)
