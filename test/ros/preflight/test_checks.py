# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Cases of each check of ``quad_mpc preflight``: no problem, warning or error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages import diagnostics
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.ros.bridges.rates import RatesConfig
from quad_mpc_ros.ros.preflight.checks import CHECKS, findings
from quad_mpc_ros.ros.preflight.facts import (
    Arrival,
    Facts,
    NodeFacts,
)
from quad_mpc_ros.ros.preflight.finding import Level
from quad_mpc_ros.ros.preflight.reference import sample_reference
from quad_mpc_ros.simulation.config import SimulatorConfig

NOW_NS = 50_000_000_000
Change = Callable[[Facts], Facts]


def arrivals(
    count: int = 50, *, period: float = 0.02, age: float = 0.002, **fields: Any
) -> tuple[Arrival, ...]:
    """Return odometries of a vehicle that rests, but for what is given."""
    found = []
    for i in range(count):
        at_ns = NOW_NS + round(1e9 * period * i)
        rest = OdometrySample.at_rest([0.0, 0.0, 0.0], stamp_ns=at_ns - round(1e9 * age))
        found.append(Arrival(odometry=dataclasses.replace(rest, **fields), at_ns=at_ns))
    return tuple(found)


GROUNDED = {"stack_fault": "", "landed": "true", "peers.command": "1"}


def fit() -> Facts:
    """Return the facts of a vehicle with which all is well."""
    reference = ReferenceConfig(trajectory="hover", height=1.5, mode="on_request")
    walls = {"fence.minimum": [-3.0, -3.0, -1.0], "fence.maximum": [3.0, 3.0, 4.0]}
    peers = {"peers.odom": "1", "peers.reference": "1", "peers.command": "1"}
    return Facts(
        nodes={
            "mpc": NodeFacts(config=MpcConfig.build(walls), state="active", values=peers),
            "reference": NodeFacts(config=reference, state="active", values={"peers.odom": "1"}),
            "recorder": NodeFacts(config=RecorderConfig(), state="active"),
            "rates_bridge": NodeFacts(config=RatesConfig(), values=GROUNDED),
        },
        arrivals=arrivals(),
        reference_samples=sample_reference(reference),
    )


FIT = fit()


def changed(**fields: Any) -> Change:
    return lambda facts: facts.changed(**fields)


def with_node(name: str, **fields: Any) -> Change:
    """Return what changes or adds a node."""

    def change(facts: Facts) -> Facts:
        node = dataclasses.replace(facts.nodes.get(name, NodeFacts()), **fields)
        return facts.changed(nodes={**facts.nodes, name: node})

    return change


def without(*names: str) -> Change:
    return lambda facts: facts.changed(
        nodes={name: node for name, node in facts.nodes.items() if name not in names}
    )


def configured(name: str, **values: Any) -> Change:
    """Return what changes parameters of a node, and what follows from those of the reference."""

    def change(facts: Facts) -> Facts:
        config = facts.nodes[name].config
        assert config is not None
        wanted = config.updated({key.replace("__", "."): each for key, each in values.items()})
        changed = with_node(name, config=wanted)(facts)
        if isinstance(wanted, ReferenceConfig):
            changed = changed.changed(reference_samples=sample_reference(wanted))
        return changed

    return change


def peer_counts(name: str, **counts: int) -> Change:
    """Return a change of the peers that a node reports on topics."""

    def change(facts: Facts) -> Facts:
        peers = {f"peers.{topic}": str(count) for topic, count in counts.items()}
        return with_node(name, values={**facts.nodes[name].values, **peers})(facts)

    return change


def both(*changes: Change) -> Change:
    def change(facts: Facts) -> Facts:
        for each in changes:
            facts = each(facts)
        return facts

    return change


def flying(*, twist_frame: str) -> tuple[Arrival, ...]:
    """Return odometries of a flight north with the nose east, its twist in a frame."""
    quarter = np.array([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])  # the nose north
    v = np.array([1.0, 0.0, 0.0]) if twist_frame == "child" else np.array([0.0, 1.0, 0.0])
    return tuple(
        dataclasses.replace(
            each,
            odometry=dataclasses.replace(
                each.odometry,
                p_WB=np.array([0.0, 0.02 * i, 1.0]),
                q_WB_xyzw=quarter,
                v_WB_B=v,
            ),
        )
        for i, each in enumerate(arrivals())
    )


HEAVY = {"mass": 0.9, "thrust_curve": [4.0, 3.0, 0.0]}
OK, WARNING, ERROR, UNKNOWN = Level.OK, Level.WARNING, Level.ERROR, Level.UNKNOWN

CASES: dict[str, dict[str, tuple[Change, Level, str]]] = {
    "nodes": {
        "no mpc": (without("mpc"), ERROR, "no mpc node"),
        "mpc not active": (
            with_node("mpc", state="inactive", health="inactive: no odometry yet"),
            ERROR,
            "mpc is not active: inactive: no odometry yet",
        ),
        "mpc hovers": (
            with_node("mpc", level=diagnostics.ERROR, health="solver: failed"),
            ERROR,
            "mpc: solver: failed",
        ),
        "another bridge": (
            changed(bridge="px4_bridge"),
            ERROR,
            "px4_bridge does not run, there is rates_bridge",
        ),
        "a bridge where none should be": (changed(bridge="none"), ERROR, "expected no bridge"),
        "no bridge": (without("rates_bridge"), WARNING, "neither a bridge nor"),
        "an own reference": (without("reference"), OK, "mpc active"),
        "no reference at all": (
            both(without("reference"), peer_counts("mpc", reference=0)),
            ERROR,
            "no reference node",
        ),
    },
    "vehicles": {
        "another mass": (
            configured("reference", mass=0.75),
            ERROR,
            "vehicles differ: mass 0.396893 of mpc and rates_bridge, 0.75 of reference",
        ),
    },
    "file": {
        "without the file's mass": (
            changed(stated={"mpc": HEAVY, "reference": {}}),
            ERROR,
            "mpc has mass 0.396893, the file 0.9",
        ),
        "with what the file states": (
            changed(stated={"mpc": {"mass": 0.396893}}),
            OK,
            "mpc match the file",
        ),
        "a file and no node to compare": (
            changed(stated={"mpc": HEAVY}, nodes={}),
            UNKNOWN,
            "no running node has parameters of the file",
        ),
    },
    "throttle": {
        "lifts little": (configured("mpc", mass=1.5), WARNING, "lift 1.27 times the weight"),
        "sinks when tilted": (
            configured("mpc", limits__tilt_max=1.5),
            WARNING,
            "set limits.tilt_max below 1.36",
        ),
        "hardly descends": (
            configured("mpc", throttle_min=0.25),
            WARNING,
            "at throttle_min 0.25 the motors still lift 0.83",
        ),
        "a thrust map too weak": (
            configured("rates_bridge", thrust_map__kind="linear", thrust_map__full_thrust=3.0),
            ERROR,
            "for a weight of 3.89 N, expected 0 to 1",
        ),
    },
    "lags": {
        "no lags": (
            configured("mpc", input_delay=0.0),
            WARNING,
            "input_delay = 0: every real vehicle lags",
        ),
        "rate loops that ring": (
            configured(
                "mpc", rate_time_constant=[0.05, 0.05, 0.2], torque_time_constant=[0.2, 0.2, 0.1]
            ),
            WARNING,
            "rate loop of roll, pitch: 1.6 Hz, damping 0.25; lower P",
        ),
        "a slow rate loop": (
            configured("mpc", rate_time_constant=0.3, torque_time_constant=0.1),
            WARNING,
            "rate loop of roll, pitch, yaw: 0.9 Hz, damping 0.87; raise P",
        ),
    },
    "limits": {
        "plans beyond the envelope": (
            configured("mpc", envelope__tilt_max=0.5),
            WARNING,
            "limits.tilt_max allows 0.61 rad in the plan, envelope.tilt_max is 0.5",
        ),
        "a reference faster than the envelope": (
            configured("mpc", envelope__speed_max=3.0, envelope__action="hover"),
            ERROR,
            "reference.max_speed is 5 m/s",
        ),
        "a reference slower than the plan": (configured("mpc", limits__speed_max=6.0), OK, ""),
    },
    "fence": {
        "no fence": (
            configured("mpc", fence__minimum=[-1e7] * 3, fence__maximum=[1e7] * 3),
            WARNING,
            "no fence is set",
        ),
        "a reference outside": (
            configured("reference", origin=[4.0, 0.0]),
            ERROR,
            "the reference would break a limit: outside the fence: x is 4.00 m, limits -3 to 3",
        ),
        "a reference too fast to stop inside": (
            configured("reference", trajectory="circle", circle_radius=2.4, circle_speed=3.0),
            ERROR,
            "at the stopping point",
        ),
        "a take-off through the roof": (
            configured("reference", takeoff_height=4.5),
            ERROR,
            "a take-off to 4.5 m would break a limit: outside the fence: z is 4.50",
        ),
        "a way that is not known here": (
            changed(reference_samples=None, reference_samples_error="there.csv does not exist"),
            UNKNOWN,
            "there.csv does not exist",
        ),
    },
    "topics": {
        "no odometry is published": (peer_counts("mpc", odom=0), ERROR, "mpc has no peer on odom"),
        "two sources of odometry": (
            peer_counts("mpc", odom=2),
            ERROR,
            "2 publishers on odom of mpc, expected one",
        ),
        "a bridge without commands": (
            peer_counts("rates_bridge", command=0),
            ERROR,
            "rates_bridge has no peer on command",
        ),
        "a reference of the same process": (
            with_node("mpc", values={"peers.odom": "1", "peers.command": "1"}),
            OK,
            "command, odom connected",
        ),
    },
    "rate": {
        "no odometry": (changed(arrivals=()), ERROR, "no odometry received"),
        "a gap": (
            lambda facts: facts.changed(arrivals=(*facts.arrivals[:20], *facts.arrivals[40:])),
            WARNING,
            "gap of 0.42 s between two odometries",
        ),
        "irregular arrivals": (
            lambda facts: facts.changed(
                arrivals=tuple(
                    dataclasses.replace(each, at_ns=each.at_ns + (16_000_000 if i % 2 else 0))
                    for i, each in enumerate(facts.arrivals)
                )
            ),
            WARNING,
            "jitter of 8 ms",
        ),
        **{
            f"{rate} Hz": (
                changed(arrivals=arrivals(3 * rate, period=1 / rate)),
                WARNING,
                f"odometry arrives at {rate}.0 Hz, mpc.control_rate is 50",
            )
            for rate in (2, 30)
        },
    },
    "clock": {
        "another clock": (changed(arrivals=arrivals(age=3.0)), ERROR, "3.00 s behind the clock"),
        "simulated time on one node": (
            with_node("mpc", use_sim_time=True),
            ERROR,
            "use_sim_time is on for mpc, off for reference, recorder, rates_bridge",
        ),
        "simulated time in lockstep": (
            both(
                without("rates_bridge"),
                *(with_node(name, use_sim_time=True) for name in ("mpc", "reference", "recorder")),
                with_node("simulator", config=SimulatorConfig(lockstep=True)),
                changed(has_clock=True),
            ),
            OK,
            "ms old",
        ),
    },
    "motion": {
        "another frame": (
            changed(arrivals=arrivals(frame_id="map")),
            ERROR,
            "50 of 50 odometries",
        ),
        "a stamp for ever": (
            changed(arrivals=arrivals(stamp_ns=NOW_NS)),
            ERROR,
            "odometry stamps do not advance",
        ),
        "speed at rest": (
            changed(arrivals=arrivals(v_WB_B=np.array([0.0, 0.8, 0.0]))),
            ERROR,
            "of 50 odometries: odometry reports motion but its values do not change",
        ),
        "speed at rest, noisy": (
            lambda facts: facts.changed(
                arrivals=tuple(
                    dataclasses.replace(
                        each,
                        odometry=dataclasses.replace(
                            each.odometry, v_WB_B=np.array([0.0, 0.8 + 0.001 * i, 0.0])
                        ),
                    )
                    for i, each in enumerate(facts.arrivals)
                )
            ),
            ERROR,
            "does not change, but the twist reports 0.82 m/s",
        ),
        "on its side": (
            changed(
                arrivals=arrivals(q_WB_xyzw=np.array([math.sin(0.3), 0.0, 0.0, math.cos(0.3)]))
            ),
            WARNING,
            "rests with a tilt of 0.60 rad",
        ),
        "a twist in the other frame": (
            changed(arrivals=flying(twist_frame="world")),
            ERROR,
            "is the heading off by 90 degrees, or is odometry.twist_frame wrong?",
        ),
        "in flight": (
            changed(arrivals=flying(twist_frame="child")),
            OK,
            "the vehicle moves; position, velocity, attitude and body rates agree",
        ),
    },
    "stack": {
        "a bridge without a heartbeat": (
            with_node("rates_bridge", values={"stack_fault": "no heartbeat", "landed": "unknown"}),
            ERROR,
            "rates_bridge: no heartbeat",
        ),
        "a vehicle that flies": (
            with_node("rates_bridge", values={**GROUNDED, "landed": "false"}),
            WARNING,
            "reports that the vehicle is flying",
        ),
        "a bridge that has not reported": (
            with_node("rates_bridge", values={}),
            UNKNOWN,
            "has not reported its health",
        ),
    },
}


def test_reports_no_problem_for_a_ready_vehicle() -> None:
    found = findings(FIT)
    assert {each.level for _, each in found} == {Level.OK}
    # All but those for what a vehicle need not have.
    assert {name for name, _ in found} == CHECKS.keys() - {"file"}


@pytest.mark.parametrize(
    ("check", "case"), [(check, case) for check, cases in CASES.items() for case in cases]
)
def test_reports_each_case_with_its_level(check: str, case: str) -> None:
    change, level, words = CASES[check][case]
    found = CHECKS[check](change(FIT))
    assert max(each.level for each in found) == level, found
    (result,) = [each for each in found if each.level is level and words in each.text][:1]
    assert bool(result.remedy) == (level in (Level.WARNING, Level.ERROR))


def test_every_check_is_tried_in_both_directions() -> None:
    tried = {(check, level is OK) for check in CASES for _, level, _ in CASES[check].values()}
    tried |= {(check, each.level is OK) for check, each in findings(FIT)}
    assert tried == {(check, well) for check in CHECKS for well in (True, False)}


@pytest.mark.parametrize("check", CHECKS)
def test_checks_tolerate_missing_data(check: str) -> None:
    """Without data, no check reports success."""
    assert Level.OK not in {each.level for each in CHECKS[check](Facts())}
