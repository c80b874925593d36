# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Base of the lifecycle nodes: transitions, parameters, health, autostart.

A node's hooks implement the transitions. This module logs a failed transition in one line,
releases its resources and publishes the state.
"""

from __future__ import annotations

import dataclasses
import functools
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Generic, TypeVar

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter

from quad_mpc_ros.configuration import ManagedConfiguration, UserError
from quad_mpc_ros.configuration.fields import unknown_parameter
from quad_mpc_ros.messages.diagnostics import WARN
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.clocks import Metronome, create_steady_timer
from quad_mpc_ros.ros.garbage_collection import freeze_gc
from quad_mpc_ros.ros.health import Health, HealthReporter
from quad_mpc_ros.ros.parameters import ManagedParameters
from quad_mpc_ros.ros.preflight.own import own_findings
from quad_mpc_ros.ros.repeated_warnings import RepeatedWarnings
from quad_mpc_ros.ros.spin import stop, until_the_end

C = TypeVar("C", bound=ManagedConfiguration)

_TRANSITIONS = {
    "unconfigured": {
        Transition.TRANSITION_CONFIGURE: "configure",
        Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: "shutdown",
    },
    "inactive": {
        Transition.TRANSITION_CLEANUP: "cleanup",
        Transition.TRANSITION_ACTIVATE: "activate",
        Transition.TRANSITION_INACTIVE_SHUTDOWN: "shutdown",
    },
    "active": {
        Transition.TRANSITION_DEACTIVATE: "deactivate",
        Transition.TRANSITION_ACTIVE_SHUTDOWN: "shutdown",
    },
}
# s: a blocked activation is logged after the first, again after the second.
_REMINDER_DELAY, _REMINDER_PERIOD = 3.0, 0.5
_SHUTDOWN_DELAY = 0.1  # s: the response to the shutdown request is sent first


class _BlockedError(UserError):
    """An activation is blocked."""


class ManagedNode(LifecycleNode, Generic[C]):
    """A node with configure, activate, deactivate and cleanup, automatic or on request.

    Publishers are not lifecycle publishers: an inactive node must not even compute a command, or
    its controller would assume that the command was sent. So a derived node checks :attr:`active`
    and overrides the hooks below. A hook raises :class:`UserError` to refuse the transition, for
    problems that the user can fix; ``deactivate`` and ``cleanup`` raise nothing. The ``__init__``
    of a derived node ends with :meth:`start`.
    """

    def __init__(self, name: str, configuration: type[C]) -> None:
        """Declare the parameters. Raises :class:`ConfigurationError` for bad values."""
        self._configured = False  # also of an incomplete node, which ROS may destroy
        super().__init__(name)
        self.exit_code = 0
        self.state = "unconfigured"
        """Lifecycle state: unconfigured, inactive, active, finalized, or a transition."""
        self.active = False
        self._autostarting = False
        self._gc_frozen = False
        self._fault: Exception | None = None
        self._resources = ExitStack()
        self._managed_parameters = ManagedParameters(self, configuration, apply=self.reconfigure)
        self.health = HealthReporter(self, self._probe)
        self.warnings = RepeatedWarnings(self)
        self._awaiting_since = 0.0
        create_steady_timer(self, _REMINDER_PERIOD, self._remind)
        # rclpy raises an exception for an impossible transition, which would end the node.
        (service,) = (each for each in self.services if each.srv_type is ChangeState)
        service.callback = functools.partial(self._on_change_state, service.callback)

    def configure(self, config: C) -> None:
        """Create the node's resources.

        The cleanup, or a failure of this hook, destroys the publishers of ``self.health`` and the
        resources of the methods ``managed_…``.
        """

    def activation_blocker(self) -> str | None:
        """Return the reason why the node cannot be activated now, or None."""
        return None

    def activate(self) -> None:
        """Start or continue."""

    def deactivate(self) -> None:
        """Stop; :attr:`active` is already false."""

    def loss_in_flight(self) -> str | None:
        """Return the consequence of a deactivation in flight, None while nothing flies."""
        return None

    def cleanup(self) -> None:
        """Release resources of ``configure`` that are not destroyed automatically."""

    def reconfigure(self, config: C) -> None:
        """Apply changed live parameters."""

    def values(self) -> list[tuple[str, str]]:
        """Return the health values of every state."""
        return []

    def report(self) -> Health:
        """Return the health of the node while it is active."""
        raise NotImplementedError

    def start(self) -> None:
        """Configure, unless ``autostart`` is false.

        Errors are raised and not logged: a node that cannot start ends.
        """
        if not self.get_parameter("autostart").value:
            return
        self._autostarting = True
        try:
            self._by_itself(self.trigger_configure)
        except BaseException:  # also signals: nothing else would release the resources
            self._release()
            raise

    def begin(self) -> None:
        """Activate a node with autostart, unless blocked.

        Raises :class:`UserError` if the node cannot start.
        """
        if self._activates_by_itself():
            if self._fault is not None:
                raise self._fault
            self.get_logger().info(self.state)
        self.health.report()

    def activate_when_ready(self) -> None:
        """Activate a node with autostart as soon as nothing blocks the activation.

        Call this whenever a blocker might have changed.
        """
        if self._activates_by_itself():
            self._report("activate")

    def _activates_by_itself(self) -> bool:
        """Try to activate a node with autostart; return whether no further attempt follows.

        A blocker might appear between the check and the transition, such as an odometry that
        becomes too old. The next call then tries again.
        """
        if not self._autostarting:
            return False
        if self.activation_blocker() is not None:
            self._remind()
            return False
        self.trigger_activate()
        self._autostarting = isinstance(self._fault, _BlockedError)
        return not self._autostarting

    def stay_inactive(self, reason: str) -> None:
        """Deactivate, or stay inactive, until a request activates the node."""
        self._autostarting = False
        self.get_logger().error(reason)
        if self.active:
            self._by_itself(self.trigger_deactivate)
            self.health.report()

    def _remind(self) -> None:
        """Log the blocker of an activation after a while, and repeatedly while it lasts."""
        if not (self._autostarting and self._configured) or self.active:
            return
        blocker = self.activation_blocker()
        if blocker is not None and time.monotonic() - self._awaiting_since > _REMINDER_DELAY:
            self.warnings.warn(f"inactive: {blocker}")

    def managed_timer(self, period: float, callback: Callable[[], float | None]) -> None:
        """Create a timer [s] until the cleanup, on the steady clock.

        If the callback returns a time [s], the callback is called again after this time.
        """

        def guarded() -> None:
            pause = callback() if self._configured else None
            if pause is not None:
                timer.timer_period_ns = round(pause * 1e9)
                timer.reset()  # without this the new period begins with the next call

        timer = create_steady_timer(self, period, guarded)
        self._resources.callback(self.destroy_timer, timer)

    def managed_beat(self, period: float, callback: Callable[[], None]) -> None:
        """Call a function every ``period`` [s] until the cleanup, even if the executor is busy.

        With simulated time, use a timer of the executor.
        """
        if self.get_clock().ros_time_is_active:
            timer = self.create_timer(period, until_the_end(self, callback))
            self._resources.callback(self.destroy_timer, timer)
            return

        def guarded() -> None:
            try:
                callback()
            except Exception:
                if rclpy.ok():  # else the node is ending
                    self.get_logger().fatal(traceback.format_exc())
                    self.exit_code = 1
                    stop()

        self._resources.callback(Metronome(period, guarded).stop)

    def managed_service(self, kind: type[Any], name: str, callback: Callable[..., Any]) -> None:
        """Create a service until the cleanup."""

        def guarded(request: Any, response: Any) -> Any:
            return callback(request, response) if self._configured else response

        service = self.create_service(kind, name, guarded)
        self._resources.callback(self.destroy_service, service)

    def managed_subscription(
        self,
        topic: Topic,
        callback: Callable[[Any], None],
        *,
        decode: Callable[[Any], Any] | None = None,
        **options: bool,
    ) -> None:
        """Create a subscription until the cleanup, see :meth:`HealthReporter.subscription`.

        The callback receives the result of ``decode``; a ``ValueError`` of ``decode`` is logged.
        """

        def guarded(message: Any) -> None:
            if not self._configured:  # the executor may hold an older one
                return
            if decode is not None:
                try:
                    message = decode(message)
                except ValueError as error:
                    self.warnings.warn(str(error))
                    return
            callback(message)

        self.health.subscription(topic, guarded, **options)

    def on_configure(self, _: Any) -> TransitionCallbackReturn:
        """Validate all parameters together and create the node's resources."""
        return self._result_of(self._configure, by="configuring", to="inactive")

    def on_activate(self, _: Any) -> TransitionCallbackReturn:
        """Start, unless blocked."""
        return self._result_of(self._activate, by="activating", to="active")

    def on_deactivate(self, _: Any) -> TransitionCallbackReturn:
        """Stop at once."""
        return self._result_of(self._deactivate, by="deactivating", to="inactive")

    def on_cleanup(self, _: Any) -> TransitionCallbackReturn:
        """Release all resources, so that the node can be configured again."""
        return self._result_of(self._release, by="cleaningup", to="unconfigured")

    def on_shutdown(self, _: Any) -> TransitionCallbackReturn:
        """Release all resources and end the process."""
        create_steady_timer(self, _SHUTDOWN_DELAY, stop)
        return self._result_of(self._release, by="shuttingdown", to="finalized")

    def on_error(self, _: Any) -> TransitionCallbackReturn:
        """Release all resources after a defect; the node can be configured again."""
        try:
            self._release()
        except Exception:
            self.get_logger().error(traceback.format_exc())
        self.state = "unconfigured"
        return TransitionCallbackReturn.SUCCESS

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters like rclpy, with the name of an unknown parameter in the error."""
        for each in parameter_list:
            if not self.has_parameter(each.name):
                known = self.get_parameters_by_prefix("")
                error = unknown_parameter(self.get_name(), each.name, each.value, known)
                return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(parameter_list)

    def destroy_node(self) -> None:
        """Release all resources, then destroy the node."""
        self._release()
        super().destroy_node()

    def _configure(self) -> None:
        try:
            config = self._managed_parameters.finalize()
            self.health.vehicle = config.vehicle_values()
            for finding in own_findings(config):
                self.get_logger().warning(finding.text)
            self.configure(config)
        except Exception:
            self._destroy_made()
            raise
        self._configured, self._awaiting_since = True, time.monotonic()
        if not self._gc_frozen:
            self._gc_frozen = True
            freeze_gc()

    def _activate(self) -> None:
        blocker = self.activation_blocker()
        if blocker is not None:
            raise _BlockedError(blocker)
        self.activate()
        self.active = True
        self._autostarting = False

    def _deactivate(self) -> None:
        self.active = False
        self.deactivate()

    def _release(self) -> None:
        if not self._configured:
            return
        self._configured = False
        try:
            if self.active:
                self._deactivate()
            self.cleanup()
        finally:
            self._destroy_made()

    def _destroy_made(self) -> None:
        self._resources.close()
        self.health.destroy_endpoints()
        self._managed_parameters.release()

    def _result_of(
        self, transition: Callable[[], None], *, by: str, to: str
    ) -> TransitionCallbackReturn:
        """Carry out a transition via the state ``by`` to ``to``; keep its error for the report."""
        before, self.state = self.state, by
        self._fault = None
        try:
            transition()
        except UserError as error:
            self._fault, self.state = error, before
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._fault, self.state = error, "errorprocessing"
            return TransitionCallbackReturn.ERROR
        self.state = to
        return TransitionCallbackReturn.SUCCESS

    def _by_itself(self, trigger: Callable[[], object]) -> None:
        trigger()
        if self._fault is not None:
            raise self._fault
        self.get_logger().info(self.state)

    def _on_change_state(
        self, carry_out: Callable[[Any, Any], Any], request: Any, response: Any
    ) -> Any:
        """Carry out a requested transition if possible, and report the result."""
        wanted = request.transition
        possible = _TRANSITIONS.get(self.state, {})
        asked = wanted.label or possible.get(wanted.id, str(wanted.id))
        if asked not in possible.values():
            self.get_logger().warning(
                f"transition {asked} refused: the node is {self.state}, expected one of "
                f"{', '.join(possible.values())}"
            )
            response.success = False
            return response
        self._autostarting = self._autostarting and asked == "activate"
        loss = self.loss_in_flight() if self.active else None
        response = carry_out(request, response)
        self._report(asked, loss)
        return response

    def _report(self, transition: str, loss: str | None = None) -> None:
        """Log and publish the new state, or the reason for a failed transition."""
        if self._fault is None and loss is not None:
            self.get_logger().warning(f"{self.state} on request in flight: {loss}")
        elif self._fault is None:
            self.get_logger().info(self.state)
        elif isinstance(self._fault, UserError):
            self.get_logger().warning(f"{transition} refused: {self._fault}")
        else:
            trace = "".join(traceback.format_exception(self._fault))
            self.get_logger().error(f"{transition} failed because of a defect: {trace}")
        self.health.report()

    def _probe(self) -> Health:
        values = [("state", self.state), *self.values()]
        if self.active:
            health = self.report()
            return dataclasses.replace(health, values=[*values, *health.values])
        why = self.activation_blocker() if self._configured else None
        if why is None and not isinstance(self._fault, _BlockedError | None):
            why = str(self._fault)
        return Health(
            level=WARN, text=self.state if why is None else f"{self.state}: {why}", values=values
        )
