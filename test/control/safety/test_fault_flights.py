# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every fault flown in one process and in simulated time."""

from __future__ import annotations

import pytest
from fixtures.faults.cases import FAULTS, Fault
from fixtures.faults.flight import FaultFlight
from fixtures.faults.verdict import complaints
from fixtures.presets import ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig

CONFIG = MpcConfig()


def flight(fault: Fault) -> FaultFlight:
    """Return a flight along a lemniscate high above the ground, or on the ground."""
    if fault.grounded:
        # The odometry is half a metre too high, so that the MPC descends to the ground.
        simulator = ideal(position_bias=(0.0, 0.0, 0.5))
        reference = ReferenceConfig(trajectory="hover", height=0.0)
    else:
        simulator = ideal(initial_position=(0.0, 0.0, 10.0), initial_throttle=0.3)
        reference = ReferenceConfig(trajectory="lemniscate", height=10.0)
    return FaultFlight(fault, mpc=CONFIG, simulator=simulator, reference=reference)


@pytest.mark.parametrize("fault", FAULTS.values(), ids=lambda fault: fault.name)
def test_a_fault_leads_to_the_expected_levels_and_recovers(fault: Fault) -> None:
    wrong = complaints(fault, flight(fault).run(), CONFIG)
    assert not wrong, "\n".join(wrong)
