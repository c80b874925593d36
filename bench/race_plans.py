# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Plan random races: success, feasibility and race times compared with minimum snap.

python bench/race_plans.py --races 100
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from typing import Any

import numpy as np
from full_quadrotor import check

from quad_mpc_ros import load_config
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.racing.gates import course_from
from quad_mpc_ros.extras.racing.planning.race_plan import plan_race
from quad_mpc_ros.references.configured import judged_trajectory
from quad_mpc_ros.references.course import Course

VEHICLE = "vehicles/cpc"
_ROOM = np.array([10.0, 10.0])  # m, to each side
_HEIGHTS = (1.2, 4.0)  # m
_APART, _TURNED = (4.0, 3.0), 0.5  # m from gate to gate, from one to any; rad off the way


def random_course(seed: int) -> dict[str, Any]:
    """Return the content of a course of 5 to 12 gates, some of them balls, from rest to rest."""
    random = np.random.default_rng(seed)
    count = int(random.integers(5, 13))
    places = [_place(random)]
    while len(places) < count + 2:
        place = _place(random)
        distances = np.linalg.norm(np.array(places) - place, axis=1)
        if distances[-1] >= _APART[0] and distances.min() >= _APART[1]:
            places.append(place)
    gates = []
    for before, here, after in zip(places[:-2], places[1:-1], places[2:], strict=True):
        position = here.round(3).tolist()
        if random.random() < 0.4:
            gates.append({"position": position, "tolerance": 0.3})
            continue
        steps = [here - before, after - here]
        way = sum(step / np.linalg.norm(step) for step in steps)
        yaw = math.atan2(way[1], way[0]) + random.uniform(-_TURNED, _TURNED)
        gates.append({"position": position, "yaw": float(yaw), "width": 1.6, "height": 1.6})
    start, end = (place.round(3).tolist() for place in (places[0], places[-1]))
    return {"start": start, "end": end, "gates": gates}


def _place(random: np.random.Generator) -> Any:
    return np.append(random.uniform(-_ROOM, _ROOM), random.uniform(*_HEIGHTS))


def minimum_snap_time(course: dict[str, Any], config: Any) -> float:
    """Return how long the smooth path takes that is as quick as the same limits allow [s]."""
    mpc = config.mpc
    reference = dataclasses.replace(
        config.reference,
        trajectory="gates",
        gates=str(course),
        time_scaling="auto",
        max_speed=1e3,
        max_acceleration=0.9 * (mpc.vehicle().thrust(1.0) / mpc.mass - mpc.gravity),
        omega_max=mpc.omega_max,
    )
    trajectory, verdict = judged_trajectory(reference)
    return 1e-9 * trajectory.period_ns if verdict.feasible else math.nan


def main() -> None:
    """Plan, check, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--races", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    options = parser.parse_args()
    config = load_config(VEHICLE)
    # Yaw at 0.3 rad/s forbids most smooth paths, which turn about the thrust: that of minimum
    # snap may turn as fast as it likes.
    free = load_config(VEHICLE, assignments=["mpc.omega_max=[15.0, 15.0, 100.0]"])
    seconds, shares, failed, bad = [], [], [], []
    for seed in range(options.first, options.first + options.races):
        content = random_course(seed)
        course: Course = course_from(content, source=f"race {seed}")
        begun = time.process_time()
        try:
            plan = plan_race(course, *config)
        except UserError as error:
            failed.append(seed)
            print(f"race {seed}: {error}", flush=True)
            continue
        seconds.append(time.process_time() - begun)
        found = check(plan, config)
        if not found.good:
            bad.append(seed)
        try:
            snap = minimum_snap_time(content, free)
        except UserError as error:
            print(f"race {seed}: minimum snap: {error}")
            snap = math.nan
        shares.append(plan.race_time / snap)
        print(
            f"race {seed}: {len(course.gates)} gates, {plan.race_time:.3f} s, minimum snap "
            f"{snap:.3f} s, planned in {seconds[-1]:.1f} s of processor time, {plan.iterations} "
            f"iterations{'' if found.good else f', not as it says: {found}'}",
            flush=True,
        )
    quantiles = np.percentile(seconds, (50, 99, 100))
    print(
        f"\n{options.races} races: {len(failed)} failed {failed}, {len(bad)} not as they say {bad}"
        f"\nprocessor time p50 {quantiles[0]:.1f} s, p99 {quantiles[1]:.1f} s, max "
        f"{quantiles[2]:.1f} s\ntime over that of minimum snap: p5, p50, p95 "
        f"{np.nanpercentile(shares, (5, 50, 95)).round(3).tolist()}, "
        f"{int(np.isnan(shares).sum())} without one"
    )


if __name__ == "__main__":
    main()
