# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What was published first is written first, however an executor hands it over."""

from __future__ import annotations

import random

from quad_mpc_ros.ros.nodes.recorder import PublishedOrder


def test_writes_in_order_of_publication() -> None:
    chance = random.Random(1)
    order = PublishedOrder()
    written: list[tuple[int, int]] = []
    published = list(range(1000))
    # As an executor does: of what waits at the same time any may be the first.
    for begin in range(0, 1000, 4):
        waiting = published[begin : begin + 4]
        chance.shuffle(waiting)
        for number in waiting:
            order.add(
                number, begin, lambda received_ns, n=number: written.append((n, received_ns))
            )
        if begin % 40 == 0:
            order.write_older()
    assert 900 < len(written) < 1000
    order.write_all()
    assert [number for number, _ in written] == published
    times = [received_ns for _, received_ns in written]
    assert times == sorted(times)
    assert [received_ns // 4 * 4 for received_ns in times] == [n // 4 * 4 for n in published]
