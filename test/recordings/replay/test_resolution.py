# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A flight in real time is recorded and resolved to the same commands."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.analysis.figures.command_comparison import compare_commands, comparison_table
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import CommandSample, ImuSample
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.recordings.logs import Received
from quad_mpc_ros.recordings.replay.resolution import Resolved, resolve
from quad_mpc_ros.recordings.run import RecordedRun
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.internal_plant import InternalPlant
from quad_mpc_ros.simulation.sensors import OdometryStream

START_NS = 1_000_000_000_000
MS = 1_000_000
# A model for which it matters when a command was sent.
MPC = MpcConfig(
    formulation="manifold",
    rate_time_constant=0.03,
    torque_time_constant=0.02,
    thrust_time_constant=0.03,
    input_delay=0.015,
    estimate_disturbance=True,
)


def recorded(value: object, time_ns: int, *, later_ns: int = 0) -> Received:
    return Received(value=value, log_time_ns=time_ns + later_ns, publish_time_ns=time_ns)


def flown_in_real_time(
    *,
    odom_rate: float = 50.0,
    silent: tuple[float, float] = (9.0, 9.0),
    engaged: dict[int, bool] | None = None,
    landed: dict[int, bool] | None = None,
    shifted: tuple[float, float, int] = (9.0, 9.0, 0),
    reset: EstimateReset | None = None,
    changes: dict[int, dict[str, object]] | None = None,
    mpc: MpcConfig = MPC,
) -> tuple[RecordedRun, list[Tick]]:
    """Fly as the node does: messages arrive late, and at the recorder later still.

    Odometry is withheld from the controller over ``silent`` seconds, when its watchdog acts; the
    first ones come before any reference. ``engaged`` and ``landed`` are by the time in
    milliseconds, and so are ``changes`` of parameters. Stamps are ``shifted`` by the last number
    [ms] over the seconds of the first two. From the stamp of a ``reset`` on odometries are in
    other coordinates. What an accelerometer measures comes later than it is stamped, if ``mpc``
    asks for it.
    """
    random = np.random.default_rng(1)
    simulator = SimulatorConfig(
        rate_time_constant=MPC.rate_time_constant,
        torque_time_constant=MPC.torque_time_constant,
        thrust_time_constant=MPC.thrust_time_constant,
        command_delay=MPC.input_delay,
        duration=3.0,
        odom_rate=odom_rate,
        initial_position=(0.0, 0.0, 2.0),
        initial_throttle=0.3,
        imu_rate=4.0 * odom_rate if mpc.uses_accelerometer else 0.0,
        imu_noise=0.3,
    )
    plant, server = (
        InternalPlant(simulator),
        ReferenceServer(ReferenceConfig(trajectory="lemniscate")),
    )
    stream = OdometryStream(plant, simulator, start_stamp_ns=START_NS)
    controller = Controller(mpc)
    server.start(START_NS)
    odometries, windows, commands, ticks, imu_samples = [], [], [], [], []
    due_imu: list[ImuSample] = []
    next_window_ns = next_watch_ns = START_NS + 33 * MS

    def take(tick: Tick | None, now_ns: int) -> None:
        if tick is None:
            return
        ticks.append(tick)
        if tick.command is not None:
            plant.apply(tick.command)
            commands.append(recorded(tick.command, now_ns, later_ns=MS // 2))

    engagements = [
        recorded(value, START_NS + time_ms * MS) for time_ms, value in (engaged or {}).items()
    ]
    landings = [
        recorded(value, START_NS + time_ms * MS) for time_ms, value in (landed or {}).items()
    ]
    due, due_landings = list(engagements), list(landings)
    resets = [] if reset is None else [recorded(reset, reset.stamp_ns)]
    due_resets = list(resets)
    changed = [
        recorded(values, START_NS + time_ms * MS) for time_ms, values in (changes or {}).items()
    ]
    due_changes = list(changed)
    while (sent := stream.step()) is not None:
        while due_resets and due_resets[0].publish_time_ns < START_NS + sent.time_ns:
            controller.reset_estimate(due_resets.pop(0).value)
        while due and due[0].publish_time_ns < START_NS + sent.time_ns:
            controller.engage(due.pop(0).value)
        while due_changes and due_changes[0].publish_time_ns < START_NS + sent.time_ns:
            controller.reconfigure(controller.config.updated(due_changes.pop(0).value))
        while due_landings and due_landings[0].publish_time_ns < START_NS + sent.time_ns:
            controller.landed(due_landings.pop(0).value)
        now_ns = START_NS + sent.time_ns + int(random.uniform(0.2, 3.0) * MS)
        due_imu += sent.imu
        while due_imu and due_imu[0].stamp_ns + int(random.uniform(0.0, 4.0) * MS) < now_ns:
            sample = due_imu.pop(0)
            imu_samples.append(recorded(sample, sample.stamp_ns, later_ns=MS))
            controller.receive_imu(sample)
        while next_window_ns < now_ns:
            window = server.window(next_window_ns)
            received_ns = next_window_ns + int(random.uniform(0.05, 0.2) * MS)
            # The recorder is sometimes slow and receives the window after the next odometry.
            windows.append(
                recorded(window, next_window_ns, later_ns=int(random.choice([1, 1, 8]) * MS))
            )
            take(controller.receive_reference(window, now_ns=received_ns), received_ns)
            next_window_ns += 20 * MS
        while next_watch_ns < now_ns:
            take(controller.watch(now_ns=next_watch_ns), next_watch_ns)
            next_watch_ns += 20 * MS
        if silent[0] <= sent.time_ns * 1e-9 < silent[1]:
            continue
        odometry = sent.odometry
        if shifted[0] <= sent.time_ns * 1e-9 < shifted[1]:
            stamp_ns = odometry.stamp_ns + shifted[2] * MS
            odometry = dataclasses.replace(odometry, stamp_ns=stamp_ns)
        if reset is not None and odometry.stamp_ns > reset.stamp_ns:
            odometry = reset.odometry(odometry)
        odometries.append(recorded(odometry, START_NS + sent.time_ns, later_ns=MS))
        take(controller.receive_odometry(odometry, now_ns=now_ns), now_ns)
    run = RecordedRun(
        bag=Path("bag"),
        odometries=odometries,
        windows=windows,
        commands=commands,
        stats=[recorded(tick.stats, 0) for tick in ticks],
        parameters={"/uav1/mpc": mpc.flattened()},
        engagements=engagements,
        landings=landings,
        resets=resets,
        changes=changed,
        imu=imu_samples,
    )
    return run, ticks


def commands_of(steps: list[Resolved]) -> list[CommandSample]:
    return [step.tick.command for step in steps if step.tick and step.tick.command]


def as_bytes(commands: list[CommandSample]) -> list[tuple[int, bytes]]:
    return [
        (command.stamp_ns, np.array([command.throttle, *command.w_WB_B]).tobytes())
        for command in commands
    ]


CHANGES: dict[int, dict[str, object]] = {
    805: {"R": [0.0, 0.3, 0.3, 0.3], "throttle_max": 0.8},
    1605: {"throttle_max": 0.9},
    2005: {"Q": [4.0, 4.0, 8.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0]},
}
WITH_IMU = dataclasses.replace(MPC, accelerometer_noise=0.5)
RESET = EstimateReset(stamp_ns=START_NS + 1205 * MS, turn=0.7, step_W=np.array([1.0, -2.0, 0.3]))


def rejects_odometries(ticks: list[Tick]) -> bool:
    """The check of stamps against arrivals includes rejected odometries."""
    return ticks[-1].stats.rejected_inputs >= 8


def waits_for_a_reference(ticks: list[Tick]) -> bool:
    return ticks[0].command is None


def uses_watchdog(ticks: list[Tick]) -> bool:
    return any(tick.stats.source == "blind" for tick in ticks)


def has_late_imu_samples(ticks: list[Tick]) -> bool:
    late = [0 < tick.stats.imu_stamp_ns < tick.stats.stamp_ns for tick in ticks]
    return sum(late) > 10


@pytest.mark.parametrize(
    ("flight", "needed", "happens"),
    [
        ({"odom_rate": 50.0}, (), waits_for_a_reference),
        ({"odom_rate": 120.0}, (), waits_for_a_reference),
        ({"shifted": (1.0, 2.0, 407)}, (), rejects_odometries),
        ({"shifted": (1.0, 2.0, -393)}, (), rejects_odometries),
        ({"silent": (1.0, 1.6)}, (), uses_watchdog),
        (
            {"engaged": {50: False, 1205: True}, "landed": {305: True, 905: False}},
            ("engagements", "landings"),
            waits_for_a_reference,
        ),
        ({"reset": RESET}, ("resets",), waits_for_a_reference),
        ({"mpc": WITH_IMU}, ("imu",), has_late_imu_samples),
        ({"changes": CHANGES}, ("changes",), waits_for_a_reference),
    ],
)
def test_resolves_real_time_bit_for_bit(
    flight: dict[str, Any], needed: tuple[str, ...], happens: Callable[[list[Tick]], bool]
) -> None:
    """Each message that a flight needs changes its commands when it is missing."""
    run, ticks = flown_in_real_time(**flight)
    mpc = flight.get("mpc", MPC)
    flown = as_bytes([tick.command for tick in ticks if tick.command])
    assert len(flown) > 100 and happens(ticks)
    assert as_bytes(commands_of(list(resolve(run, mpc)))) == flown
    for messages in needed:
        without = dataclasses.replace(run, **{messages: ()})
        assert as_bytes(commands_of(list(resolve(without, mpc)))) != flown


def test_given_parameters_override_changes_in_flight() -> None:
    run, _ = flown_in_real_time(changes=CHANGES)
    others = {ms: {k: v for k, v in set_.items() if k != "R"} for ms, set_ in CHANGES.items()}
    without, _ = flown_in_real_time(changes=others)
    same_flight = dataclasses.replace(run, changes=without.changes)
    gentle = MPC.updated({"R": [0.0, 0.1, 0.1, 0.1]})
    asked = as_bytes(commands_of(list(resolve(run, gentle))))
    assert asked == as_bytes(commands_of(list(resolve(same_flight, gentle))))


def test_resolves_without_stats() -> None:
    run, _ = flown_in_real_time()
    bare = RecordedRun(
        bag=run.bag,
        odometries=run.odometries,
        windows=run.windows,
        commands=run.commands,
        stats=[],
        parameters={},
    )
    comparison = compare_commands(
        [sent.value for sent in run.commands], commands_of(list(resolve(bare, MPC)))
    )
    assert comparison.only_recorded <= 2
    # When things came is not known: odometry that came up to 3 ms later is taken as in time.
    off = np.abs(comparison.resolved - comparison.recorded)
    assert off[:, 0].max() < 0.01
    assert off[:, 1:].max() < 0.05  # rad/s
    assert all(len(line) <= 80 for line in comparison_table(comparison).splitlines())


def test_given_reference_replaces_the_recorded_one() -> None:
    run, _ = flown_in_real_time()
    server = ReferenceServer(ReferenceConfig(trajectory="hover"))
    server.start(START_NS)
    steps = list(resolve(run, MPC, windows=server.window))
    assert len(commands_of(steps)) == len(run.odometries)
    for step in steps:
        assert step.window is not None and step.odometry is not None
        assert step.window.stamp_ns == step.odometry.value.stamp_ns
        assert np.ptp(step.window.p_WB, axis=0).max() == 0.0


def test_lockstep_pairs_by_stamp() -> None:
    run, _ = flown_in_real_time()
    lockstep = MPC.updated({"lockstep": True})
    server = ReferenceServer(ReferenceConfig(trajectory="lemniscate"))
    server.start(START_NS)
    windows = [
        recorded(server.window(odometry.value.stamp_ns), odometry.log_time_ns)
        for odometry in run.odometries
    ]

    def resolved(odometries: list[Received], windows: list[Received]) -> list[CommandSample]:
        again = RecordedRun(
            bag=run.bag,
            odometries=odometries,
            windows=windows,
            commands=[],
            stats=[],
            parameters={},
        )
        return commands_of(list(resolve(again, lockstep)))

    straight = resolved(list(run.odometries), windows)
    assert len(straight) == len(run.odometries)
    twice = [odometry for odometry in run.odometries for _ in range(2)]
    assert as_bytes(resolved(twice, windows[::-1])) == as_bytes(straight)
