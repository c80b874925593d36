"""Every fault, what it must lead to, and by when it must be recovered: the one table of them."""

from __future__ import annotations

import enum
import functools
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

import numpy as np

from quad_mpc_ros.configuration.text_tables import markdown_table
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.experiments.faults import courses, distortions
from quad_mpc_ros.experiments.faults.courses import Course
from quad_mpc_ros.experiments.faults.distortions import Distortion
from quad_mpc_ros.experiments.faults.solver import SolverFault
from quad_mpc_ros.references.config import ReferenceConfig


class ProcessFault(enum.Enum):
    """What is done to processes instead of messages."""

    PAUSE_MPC = "SIGSTOP, SIGCONT"
    RESTART_SIMULATOR = "end it, start another"
    SET_PARAMETERS = "set_parameters_atomically"
    START_NODES = "start them"


def _at_once(config: MpcConfig) -> float:
    """The next message comes within a period, and is answered within another."""
    return 2.0 / config.control_rate


def _when_renewed(config: MpcConfig) -> float:
    """A reference that does not change is published again after a while, by default."""
    return ReferenceConfig().renewal_period + _at_once(config)


def _when_accepted(config: MpcConfig) -> float:
    """Stamps that jump back must persist, too, before they are accepted."""
    return config.odom_timeout + 2.0 / config.control_rate


@dataclass(frozen=True)
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
    course: Callable[[MpcConfig], Course] = courses.unaffected
    _: KW_ONLY
    duration: float = 1.0
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
_LONG = 1.7  # s: until silent
_REACH = 2.2  # s: until a window of the reference is used up

_unusable_odometry = functools.partial(
    Fault, course=courses.odometry_lost, duration=_BRIEF, counter="rejected_inputs"
)
_odometry_of_another_time = functools.partial(
    Fault, course=courses.clocks_apart, recovery=_when_accepted, counter="rejected_inputs"
)
_unusable_reference = functools.partial(
    Fault,
    course=courses.reference_lost,
    duration=_REACH,
    recovery=_when_renewed,
    counter="rejected_inputs",
)
_solver_failure = functools.partial(
    Fault, course=courses.solver_lost, duration=_BRIEF, counter="solver_failures"
)
_clock_set = functools.partial(
    Fault, course=courses.accepted_after_timeout, recovery=_when_accepted
)
_on_the_ground = functools.partial(Fault, grounded=True)

_TABLE = (
    Fault(
        "odometry_stops",
        "no odometry",
        courses.odometry_lost,
        duration=_LONG,
        odometry=distortions.lost,
    ),
    Fault(
        "odometry_freezes",
        "the last pose and twist repeated under new stamps, in motion",
        courses.odometry_frozen,
        duration=_BRIEF,
        odometry=distortions.frozen,
    ),
    Fault(
        "odometry_repeats",
        "the last odometry repeated, with its stamp",
        courses.odometry_lost,
        duration=_BRIEF,
        odometry=distortions.repeated,
    ),
    Fault(
        "odometry_jumps",
        "position 2.4 m aside, and back",
        counter="rejected_inputs",
        odometry=distortions.changed(p_WB=distortions.moved(2.0, -1.0, 1.0)),
    ),
    Fault(
        "odometry_jumps_to_and_fro",
        "position 30 m aside for 2 s, back for 2 s, and so on",
        duration=6.0,
        home=0.0,
        counter="rejected_inputs",
        odometry=distortions.now_and_then(
            2.0, distortions.changed(p_WB=distortions.moved(30.0, 0.0, 0.0))
        ),
    ),
    _unusable_odometry(
        "odometry_nan",
        "positions that are not a number",
        odometry=distortions.changed(p_WB=distortions.not_a_number),
    ),
    _unusable_odometry(
        "odometry_wrong_frame",
        "another world frame in the header",
        odometry=distortions.changed(frame_id=distortions.elsewhere),
    ),
    _unusable_odometry(
        "odometry_not_unit",
        "quaternions 10 % too long",
        odometry=distortions.changed(q_WB_xyzw=lambda q_WB_xyzw: 1.1 * q_WB_xyzw),
    ),
    _unusable_odometry(
        "odometry_backwards",
        "stamps that run backwards",
        odometry=distortions.running_backwards,
    ),
    _odometry_of_another_time(
        "odometry_from_past",
        "stamps 5 s early, and right again",
        odometry=distortions.shifted_in_time(-5.0),
    ),
    _odometry_of_another_time(
        "odometry_from_future",
        "stamps 5 s late, and right again",
        odometry=distortions.shifted_in_time(5.0),
    ),
    Fault(
        "odometry_stamp_outliers",
        "one stamp in ten from 10 s in the future",
        counter="rejected_inputs",
        odometry=distortions.sometimes_from_the_future,
    ),
    Fault(
        "odometry_dropouts",
        "30 % of the odometries lost at random",
        duration=2.0,
        odometry=distortions.dropping(0.3),
    ),
    Fault(
        "odometry_bursts",
        "nothing for 200 ms, then all at once, again and again",
        odometry=distortions.in_bursts(0.2),
    ),
    Fault(
        "odometry_stalls",
        "nothing for 300 ms, then all at once",
        duration=0.3,
        odometry=distortions.in_bursts(0.3),
    ),
    Fault(
        "two_odometries",
        "a second publisher of odometry, 0.5 m aside",
        odometry=distortions.doubled(
            p_WB=distortions.moved(0.5, 0.0, 0.0), stamp_ns=lambda ns: ns + 1_000_000
        ),
        intruder=True,
    ),
    Fault(
        "reference_stops",
        "no reference",
        courses.reference_lost,
        duration=_REACH,
        recovery=_when_renewed,
        reference=distortions.lost,
    ),
    _unusable_reference(
        "reference_nan",
        "velocities that are not a number",
        reference=distortions.changed(v_WB_W=distortions.not_a_number),
    ),
    _unusable_reference(
        "reference_empty",
        "windows without a sample",
        reference=distortions.changed(
            **dict.fromkeys(
                ("offset_ns", "p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W"),
                lambda samples: samples[:0],
            )
        ),
    ),
    _unusable_reference(
        "reference_wrong_frame",
        "another world frame in the header",
        reference=distortions.changed(frame_id=distortions.elsewhere),
    ),
    _unusable_reference(
        "reference_not_unit",
        "quaternions that are zero",
        reference=distortions.changed(q_WB_xyzw=np.zeros_like),
    ),
    Fault(
        "reference_far_away",
        "a reference 1.4 km away, and back",
        home=10.0,
        reference=distortions.changed(p_WB=distortions.moved(1000.0, 1000.0, 0.0)),
    ),
    Fault(
        "two_references",
        "a second publisher of the reference, 0.5 m aside",
        reference=distortions.doubled(p_WB=distortions.moved(0.5, 0.0, 0.0)),
        intruder=True,
    ),
    _solver_failure(
        "solver_fails", "every solve ends at the limit of iterations", solver=SolverFault.FAIL
    ),
    _solver_failure(
        "solver_lies", "every solve is called solved, and is NaN", solver=SolverFault.LIE
    ),
    _solver_failure(
        "solver_runs_long",
        "every solve takes a period and a half",
        counter="deadline_misses",
        solver=SolverFault.RUN_LONG,
    ),
    _clock_set("clock_forward", "every clock is set a day on, and back", clock=86400.0),
    _clock_set("clock_backward", "every clock is set a day back, and on", clock=-86400.0),
    Fault(
        "mpc_pauses",
        "the MPC's process stands still",
        courses.throughout(*courses.ANY),  # it does not run, and what comes first is chance
        process=ProcessFault.PAUSE_MPC,
    ),
    Fault(
        "simulator_restarts",
        "the simulator ends, and another starts where the first one did",
        courses.odometry_lost,
        duration=_LONG,
        home=10.0,
        process=ProcessFault.RESTART_SIMULATOR,
    ),
    Fault(
        "parameters_hammered",
        "50 changes of parameters a second, every other one wrong",
        process=ProcessFault.SET_PARAMETERS,
    ),
    Fault(
        "start_orders",
        "simulator, reference and MPC started one after another, in every order",
        duration=0.0,
        process=ProcessFault.START_NODES,
    ),
    _on_the_ground(
        "ground_odometry_stops",
        "on the ground: no odometry",
        functools.partial(courses.odometry_lost, standing=True),
        duration=_LONG,
        odometry=distortions.lost,
    ),
    _on_the_ground(
        "ground_odometry_freezes",
        "on the ground: the same pose and twist repeated under new stamps",
        odometry=distortions.frozen,
    ),
    _on_the_ground(
        "ground_reference_stops",
        "on the ground: no reference",
        functools.partial(courses.reference_lost, standing=True),
        duration=_REACH,
        recovery=_when_renewed,
        reference=distortions.lost,
    ),
    _on_the_ground(
        "ground_solver_fails",
        "on the ground: every solve ends at the limit of iterations",
        functools.partial(courses.solver_lost, standing=True),
        duration=_BRIEF,
        counter="solver_failures",
        solver=SolverFault.FAIL,
    ),
)

FAULTS: dict[str, Fault] = {fault.name: fault for fault in _TABLE}
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
