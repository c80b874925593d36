"""Every fault, what it must lead to, and when all must be well again: the one table of them."""

from __future__ import annotations

import enum
import functools
from collections.abc import Callable
from dataclasses import dataclass

from quad_mpc_ros.faults import courses, distortions
from quad_mpc_ros.faults.courses import Course
from quad_mpc_ros.faults.distortions import Distortion
from quad_mpc_ros.faults.solver import SolverFault
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.text_tables import markdown_table


class ProcessFault(enum.Enum):
    """What is done to processes instead of messages."""

    PAUSE_MPC = "SIGSTOP, SIGCONT"
    RESTART_SIMULATOR = "end it, start another"
    SET_PARAMETERS = "set_parameters_atomically"
    START_NODES = "start them"


def _at_once(config: MpcConfig) -> float:
    """The next message comes within a period, and is answered within another."""
    return 2.0 / config.control_rate


def _when_believed(config: MpcConfig) -> float:
    """Stamps that jump back are a jump again, which must persist first."""
    return config.odom_timeout + 2.0 / config.control_rate


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault: something is done to the odometry, the reference, the solver, the clock or a
    process for ``duration`` seconds.

    ``course`` says which rungs follow, ``recovery`` how long after the end [s] the MPC must
    command again, ``home`` how long after that [s] the vehicle must be back at its reference.
    ``counter`` is the key of ``mpc/stats`` that must have grown. An ``intruder`` is a second
    publisher. ``grounded`` ones are for a vehicle that stands on the ground.
    """

    name: str
    injected: str
    duration: float
    course: Callable[[MpcConfig], Course]
    recovery: Callable[[MpcConfig], float] = _at_once
    home: float = 4.0
    counter: str = ""
    odometry: Distortion[OdometrySample] | None = None
    reference: Distortion[ReferenceWindow] | None = None
    solver: SolverFault | None = None
    clock: float = 0.0
    process: ProcessFault | None = None
    intruder: bool = False
    grounded: bool = False

    @property
    def switch(self) -> str:
        """What makes the MPC's process fail by itself, if anything: its solver or its clock."""
        if self.solver is not None:
            return self.solver.value
        return self.name if self.clock else ""


_BRIEF = 0.6  # s: until blind, or hovering after a failed solver
_LONG = 1.5  # s: until silent

_ODOMETRY = (
    Fault(
        name="odometry_stops",
        injected="no odometry",
        duration=_LONG,
        course=courses.odometry_lost,
        odometry=distortions.lost,
    ),
    Fault(
        name="odometry_freezes",
        injected="the last pose and twist for ever, under new stamps, though they tell of motion",
        duration=_BRIEF,
        course=courses.odometry_frozen,
        odometry=distortions.frozen,
    ),
    Fault(
        name="odometry_repeats",
        injected="the last odometry for ever, stamp and all",
        duration=_BRIEF,
        course=courses.odometry_lost,
        odometry=distortions.repeated,
    ),
    Fault(
        name="odometry_jumps",
        injected="position 2.4 m aside, and back",
        duration=1.0,
        course=courses.unimpressed,
        odometry=distortions.changed(distortions.aside),
    ),
    Fault(
        name="odometry_nan",
        injected="positions that are not a number",
        duration=_BRIEF,
        course=courses.odometry_lost,
        counter="rejected_inputs",
        odometry=distortions.changed(distortions.not_a_number),
    ),
    Fault(
        name="odometry_wrong_frame",
        injected="another world frame in the header",
        duration=_BRIEF,
        course=courses.odometry_lost,
        counter="rejected_inputs",
        odometry=distortions.changed(distortions.in_another_frame),
    ),
    Fault(
        name="odometry_not_unit",
        injected="quaternions 10 % too long",
        duration=_BRIEF,
        course=courses.odometry_lost,
        counter="rejected_inputs",
        odometry=distortions.changed(distortions.not_of_unit_length),
    ),
    Fault(
        name="odometry_backwards",
        injected="stamps that run backwards",
        duration=_BRIEF,
        course=courses.odometry_lost,
        counter="rejected_inputs",
        odometry=distortions.running_backwards,
    ),
    Fault(
        name="odometry_from_past",
        injected="stamps 5 s early, and right again",
        duration=1.0,
        course=courses.clocks_apart,
        recovery=_when_believed,
        counter="rejected_inputs",
        odometry=distortions.shifted_in_time(-5.0),
    ),
    Fault(
        name="odometry_from_future",
        injected="stamps 5 s late, and right again",
        duration=1.0,
        course=courses.clocks_apart,
        recovery=_when_believed,
        counter="rejected_inputs",
        odometry=distortions.shifted_in_time(5.0),
    ),
    Fault(
        name="odometry_stamp_outliers",
        injected="one stamp in ten from 10 s in the future",
        duration=1.0,
        course=courses.unimpressed,
        counter="rejected_inputs",
        odometry=distortions.sometimes_from_the_future,
    ),
    Fault(
        name="odometry_dropouts",
        injected="30 % of the odometries lost at random",
        duration=2.0,
        course=courses.held_at_most,
        odometry=distortions.dropping(0.3),
    ),
    Fault(
        name="odometry_bursts",
        injected="nothing for 200 ms, then all at once, again and again",
        duration=1.0,
        course=courses.blind_at_most,
        odometry=distortions.in_bursts(0.2),
    ),
    Fault(
        name="two_odometries",
        injected="a second publisher of odometry, 0.5 m aside",
        duration=1.0,
        course=courses.unimpressed,
        odometry=distortions.doubled(distortions.of_another_estimator),
        intruder=True,
    ),
)

_REFERENCE = (
    Fault(
        name="reference_stops",
        injected="no reference",
        duration=1.0,
        course=courses.reference_lost,
        reference=distortions.lost,
    ),
    Fault(
        name="reference_nan",
        injected="velocities that are not a number",
        duration=1.0,
        course=courses.reference_lost,
        counter="rejected_inputs",
        reference=distortions.changed(distortions.reference_not_a_number),
    ),
    Fault(
        name="reference_empty",
        injected="windows without a sample",
        duration=1.0,
        course=courses.reference_lost,
        counter="rejected_inputs",
        reference=distortions.changed(distortions.reference_empty),
    ),
    Fault(
        name="reference_wrong_frame",
        injected="another world frame in the header",
        duration=1.0,
        course=courses.reference_lost,
        counter="rejected_inputs",
        reference=distortions.changed(distortions.reference_in_another_frame),
    ),
    Fault(
        name="reference_not_unit",
        injected="quaternions that are zero",
        duration=1.0,
        course=courses.reference_lost,
        counter="rejected_inputs",
        reference=distortions.changed(distortions.reference_not_of_unit_length),
    ),
    Fault(
        name="reference_far_away",
        injected="a reference 1.4 km away, and back",
        duration=1.0,
        course=courses.unimpressed,
        home=10.0,
        reference=distortions.changed(distortions.reference_far_away),
    ),
    Fault(
        name="two_references",
        injected="a second publisher of the reference, 0.5 m aside",
        duration=1.0,
        course=courses.unimpressed,
        reference=distortions.doubled(distortions.reference_of_another_server),
        intruder=True,
    ),
)

_SOLVER = (
    Fault(
        name="solver_fails",
        injected="every solve ends at the limit of iterations",
        duration=_BRIEF,
        course=courses.solver_lost,
        counter="solver_failures",
        solver=SolverFault.FAIL,
    ),
    Fault(
        name="solver_lies",
        injected="every solve is called solved, and is NaN",
        duration=_BRIEF,
        course=courses.solver_lost,
        counter="solver_failures",
        solver=SolverFault.LIE,
    ),
    Fault(
        name="solver_runs_long",
        injected="every solve takes a period and a half",
        duration=_BRIEF,
        course=courses.solver_lost,
        counter="deadline_misses",
        solver=SolverFault.RUN_LONG,
    ),
)

_MACHINE = (
    Fault(
        name="clock_forward",
        injected="every clock is set a day on, and back",
        duration=1.0,
        course=courses.accepted_after_timeout,
        recovery=_when_believed,
        clock=86400.0,
    ),
    Fault(
        name="clock_backward",
        injected="every clock is set a day back, and on",
        duration=1.0,
        course=courses.accepted_after_timeout,
        recovery=_when_believed,
        clock=-86400.0,
    ),
    Fault(
        name="mpc_pauses",
        injected="the MPC's process stands still",
        duration=1.0,
        course=courses.anything,
        process=ProcessFault.PAUSE_MPC,
    ),
    Fault(
        name="simulator_restarts",
        injected="the simulator ends, and another starts where the first one did",
        duration=_LONG,
        course=courses.odometry_lost,
        home=10.0,
        process=ProcessFault.RESTART_SIMULATOR,
    ),
    Fault(
        name="parameters_hammered",
        injected="50 changes of parameters a second, every other one wrong",
        duration=1.0,
        course=courses.unimpressed,
        process=ProcessFault.SET_PARAMETERS,
    ),
    Fault(
        name="start_orders",
        injected="simulator, reference and MPC started one after another, in every order",
        duration=0.0,
        course=courses.unimpressed,
        process=ProcessFault.START_NODES,
    ),
)

_GROUND = (
    Fault(
        name="ground_odometry_stops",
        injected="on the ground: no odometry",
        duration=_LONG,
        course=functools.partial(courses.odometry_lost, standing=True),
        odometry=distortions.lost,
        grounded=True,
    ),
    Fault(
        name="ground_odometry_freezes",
        injected="on the ground: the same pose and twist for ever, which tell of rest",
        duration=1.0,
        course=courses.unimpressed,
        odometry=distortions.frozen,
        grounded=True,
    ),
    Fault(
        name="ground_reference_stops",
        injected="on the ground: no reference",
        duration=1.0,
        course=functools.partial(courses.reference_lost, standing=True),
        reference=distortions.lost,
        grounded=True,
    ),
    Fault(
        name="ground_solver_fails",
        injected="on the ground: every solve ends at the limit of iterations",
        duration=_BRIEF,
        course=functools.partial(courses.solver_lost, standing=True),
        counter="solver_failures",
        solver=SolverFault.FAIL,
        grounded=True,
    ),
)

FAULTS: dict[str, Fault] = {
    fault.name: fault for fault in (*_ODOMETRY, *_REFERENCE, *_SOLVER, *_MACHINE, *_GROUND)
}
"""Every fault by its name."""


def fault_table() -> str:
    """Return in Markdown what is injected and, with default parameters, what must follow."""
    config = MpcConfig()
    rows = [
        (
            f"`{fault.name}`",
            fault.injected,
            f"{fault.duration:g}",
            courses.described(fault.course(config), fault.duration),
            f"{fault.recovery(config):.2f} s",
        )
        for fault in FAULTS.values()
    ]
    return markdown_table(("fault", "injected", "s", "must lead to", "MPC again within"), rows)
