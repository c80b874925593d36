# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The guide stage: the window and the corridor to fly, and the interface of guides.

Guides change the reference for obstacles or gates in each tick.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.delayed_reference import DelayedReference
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.stage import Due, Failure, Stage, StageLog

FAILED = "failed"
"""State of avoidance when the guide raised an error."""


class Avoidance(NamedTuple):
    """State of the avoidance and its reason.

    ``state`` is free (the reference is flown), around, or stopped; failed if the guide raised an
    error, off without a guide. ``clearance`` [m] is between the surfaces of the vehicle and the
    nearest known obstacle, infinity if no obstacle is near.
    """

    state: str = "off"
    reason: str = ""
    clearance: float = float("inf")


class Guided(NamedTuple):
    """The window to fly, and the free region, None for no constraint."""

    window: ReferenceWindow
    corridor: Corridor | None = None
    avoidance: Avoidance = Avoidance()


class Guide(Stage, ABC):
    """Changes the reference to avoid obstacles.

    If the reference is free, the guide returns the unchanged window without a corridor, so that
    the commands equal those without a guide. If a guide raises, the reference is flown without a
    corridor in that step; the next step calls the guide again.
    """

    @abstractmethod
    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        """Return the window and corridor to fly from an odometry on; ``plan`` is the last plan."""


class GuideStage(Stage):
    """The delayed and guided reference.

    Attributes:
        guide: The guide, None without a guide.
        guided: Last result of the guide, None before the first result and without a guide.
        window: Window flown instead of the reference, None for the reference itself.
        corridor: The free region, None for no constraint.
        delayed: The reference, delayed like the vehicle.
    """

    def __init__(self, config: MpcConfig, guide: Guide | None, log: StageLog) -> None:
        self._log = log
        self.guide = guide
        self.guided: Guided | None = None
        self.window: ReferenceWindow | None = None
        self.corridor: Corridor | None = None
        self._plan: Plan | None = None
        self.delayed = DelayedReference()

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform plan, windows and corridors by an announced odometry jump."""
        if self._plan is not None:
            axes = reset.vectors(self._plan.R_WB.swapaxes(1, 2)).swapaxes(1, 2)
            self._plan = self._plan._replace(p_WB=reset.points(self._plan.p_WB), R_WB=axes)
        if self.guided is not None:
            window, corridor, avoidance = self.guided
            self.guided = Guided(reset.window(window), _moved(corridor, reset), avoidance)
        if self.window is not None:
            self.window = reset.window(self.window)
        self.corridor = _moved(self.corridor, reset)

    def step(
        self, due: Due, state: PredictedState | Failure, reference: ReferenceWindow | Failure
    ) -> Guided | Failure:
        """Return the window and corridor to fly.

        Without odometry the last result is used. If the delay or the guide fails, the reference is
        flown unchanged.
        """
        if isinstance(reference, Failure):
            return reference
        if isinstance(state, Failure):
            return state
        guided = self._guided_window(due.odometry, self._delayed_window(reference, due.sent_ns))
        self.window = None if guided.window is reference else guided.window
        self.corridor = guided.corridor
        return guided

    def _delayed_window(self, reference: ReferenceWindow, sent_ns: int) -> ReferenceWindow:
        try:
            return self.delayed.at(reference, sent_ns)
        except Exception as error:
            self._log.stage_error("delayed reference", error)
            self.delayed.reset()
            return reference

    def _guided_window(self, odometry: OdometrySample | None, window: ReferenceWindow) -> Guided:
        if odometry is None:
            last = self.guided
            return Guided(window) if last is None or last.avoidance.state == FAILED else last
        if self.guide is None:
            return Guided(window)
        try:
            self.guided = self.guide.guide(odometry, window, self._plan)
        except Exception as error:
            failure = self._log.stage_error("guide", error)
            self.guided = Guided(window, None, Avoidance(FAILED, failure.reason))
        return self.guided

    def record(self, plan: Plan | None, *, sent_ns: int) -> None:
        """Take the plan that is flown, None without a plan."""
        self._plan = plan
        if plan is not None and plan.speeds.size > 0:
            self.delayed.take(plan, stamp_ns=sent_ns)


def _moved(corridor: Corridor | None, reset: EstimateReset) -> Corridor | None:
    return None if corridor is None else reset.corridor(corridor)
