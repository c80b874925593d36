# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run nodes from the command line: start, spin, clean end, exit code."""

from __future__ import annotations

import functools
import gc
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, Self

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import (
    SignalHandlerOptions,
    install_signal_handlers,
    uninstall_signal_handlers,
)
from rclpy.task import Future

from quad_mpc_ros.configuration import ConfigurationError, UserError, files
from quad_mpc_ros.ros.garbage_collection import free_memory, freeze_gc
from quad_mpc_ros.ros.parameter_files import check_names, read_arguments
from quad_mpc_ros.ros.parameters import declared

_P = ParamSpec("_P")

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
# A signal just before the executor waits does not wake it: it ends after this time [s].
_SPIN_TIMEOUT = 1.0
_DRAIN_TIMEOUT = 0.02  # s, of waiting for a message
_END_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWITCH_INTERVAL = 0.0005  # s; Python's own are 5 ms, a quarter of a control period


def run(
    create: Callable[[], Node],
    args: list[str] | None = None,
    *,
    others: Sequence[Callable[[], Node]] = (),
    message_info: bool = False,
) -> int:
    """Create a node, spin it until SIGINT, SIGTERM or :func:`stop`, and return the exit code.

    Args:
        create: Creates the node. The node's ``begin``, if any, is called when all nodes exist.
            From then on a signal ends the node with its ``exit_code``, or 0. Before that its
            method ``drain``, if any, handles messages that wait; the argument spins once.
        args: Command line arguments for ROS; by default the arguments of the process, which then
            ends with the node.
        others: Create further nodes, each with its own thread, so that a slow callback does not
            delay other nodes. All nodes end when one ends.
        message_info: Whether a callback of the node has the message info as an argument.

    Returns:
        The exit code: 2 for an invalid parameter, file or argument, with one line on stderr; 130
        for a signal during the start.
    """
    if others:
        sys.setswitchinterval(_SWITCH_INTERVAL)
    with _Signals(process_ends=args is None) as signals:
        return _run([create, *others], args, signals, message_info=message_info)


def _run(
    creates: Sequence[Callable[[], Node]],
    args: list[str] | None,
    signals: _Signals,
    *,
    message_info: bool,
) -> int:
    nodes: list[Node] = []
    threads: list[threading.Thread] = []
    executors: list[Any] = []
    try:
        arguments = sys.argv[1:] if args is None else args
        given, own = read_arguments(arguments)
        if own and len(creates) == 1:
            raise UserError(f"given {' '.join(own)}, expected arguments for ROS, after --ros-args")
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        # rclpy's signal thread reads the list of executors without a lock: adding or freeing one
        # meanwhile is a segmentation fault. So executors exist before and after that thread.
        # No multi-threaded executor: a single thread owns the controller.
        executors += [fastest_executor(message_info=message_info) for _ in creates]
        declared.clear()
        try:
            for create in creates:
                nodes.append(create())
        except ConfigurationError as error:
            check_names(given, declared)  # a misspelt name may be the cause
            raise files.located(error, given) from error
        check_names(given, declared)
        freeze_gc()
        signals.starting = False
        for node in nodes:
            if begin := getattr(node, "begin", None):
                begin()
        for node, executor in zip(nodes, executors, strict=True):
            _register(node, executor)
        drains = [drain for node in nodes if (drain := getattr(node, "drain", None))]
        if not drains:  # rclpy's handler shuts ROS down, after which nothing can be received
            install_signal_handlers(SignalHandlerOptions.ALL)
        if not signals.received:
            threads += map(_spinning, nodes[1:], executors[1:])
            _spin(executors[0], signals)
        for drain in drains if rclpy.ok() else ():
            drain(lambda: executors[0].spin_once(timeout_sec=_DRAIN_TIMEOUT))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except ExternalShutdownException:
        pass
    except Exception:
        if rclpy.ok() and not signals.received:
            raise  # else a signal came: rclpy fails at the next call
    finally:
        signals.ignore()  # so that files are written completely
        uninstall_signal_handlers()  # returns when the signal thread has ended
        if threads:
            rclpy.try_shutdown()  # ends their spinning
        for thread in threads:
            thread.join()
        executors.clear()
        exit_codes = [0]
        for node in reversed(nodes):
            node.destroy_node()
            exit_codes.append(int(getattr(node, "exit_code", 0)))
            # A lifecycle node owns DDS entities and threads, and refers to itself. Collecting it
            # as garbage would take longer than everything else.
            vars(node).clear()
        rclpy.try_shutdown()
    return max(exit_codes)


class _Signals:
    """Handler of SIGINT and SIGTERM: ends a starting process, later only records the signal.

    Nothing is written before the start is complete, so the process may end anywhere. An exception
    would be lost in a callback of C. When the nodes spin, rclpy's handler ends the spinning.
    """

    def __init__(self, *, process_ends: bool) -> None:
        """Initialise; only a process that ends with its nodes handles the signals."""
        self.starting = True
        self.received = False
        """Whether a signal was received."""
        is_main = threading.current_thread() is threading.main_thread()
        self._handled = _END_SIGNALS if process_ends and is_main else ()

    def __enter__(self) -> Self:
        for number in self._handled:  # as rclpy also those that the parent process ignores
            signal.signal(number, self._on_signal)
        return self

    def ignore(self) -> None:
        """Ignore further signals."""
        for number in self._handled:
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, _number: int, _frame: object) -> None:
        if self.starting:
            os._exit(EXIT_INTERRUPTED)
        self.received = True

    def __exit__(self, *_: object) -> None:
        if self._handled:
            if self.starting:  # threads of an incomplete node could abort the process
                free_memory()
            gc.freeze()  # else the final collection takes half a second


def stop() -> None:
    """End the spinning node after the current callback."""
    rclpy.try_shutdown()


def until_the_end(node: Node, callback: Callable[_P, None]) -> Callable[_P, None]:
    """Return a callback whose errors are ignored after ROS was shut down."""

    # From Kilted on, rclpy passes a TimerInfo to callbacks whose signature accepts one.
    @functools.wraps(callback)
    def guarded(*arguments: _P.args, **named: _P.kwargs) -> None:
        try:
            callback(*arguments, **named)
        except Exception:
            if node.context.ok():
                raise

    return guarded


def _spinning(node: Any, executor: Any) -> threading.Thread:
    """Return a thread that spins a node; an error ends the whole process."""

    def spin() -> None:
        try:
            _spin(executor)
        except ExternalShutdownException:
            pass
        except Exception:
            if rclpy.ok():
                node.get_logger().fatal(traceback.format_exc())
                node.exit_code = 1
                stop()

    thread = threading.Thread(target=spin)
    thread.start()
    return thread


def _register(node: Node, executor: Any) -> None:
    """Add a node to an executor and wait until the executor has registered its entities.

    The events executor aborts the process if ROS is shut down during registration. So signals do
    not shut ROS down before.
    """
    executor.add_node(node)
    registered = executor.create_task(lambda: None)  # runs afterwards
    while rclpy.ok() and not registered.done():
        executor.spin_until_future_complete(registered, timeout_sec=_SPIN_TIMEOUT)


def _spin(executor: Any, signals: _Signals | None = None) -> None:
    while rclpy.ok() and not (signals is not None and signals.received):
        try:
            if isinstance(executor, SingleThreadedExecutor):
                # Not with a future: each call would add a callback to it.
                executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
            else:
                # Not spin(): the timeout of the events executor of rclpy 7.1.6 overflows on some
                # C libraries and uses a whole core.
                executor.spin_until_future_complete(Future(), timeout_sec=_SPIN_TIMEOUT)
        except RuntimeError:  # of rclpy
            if rclpy.ok():
                raise  # else a signal came before the plain executor waited


def fastest_executor(*, message_info: bool) -> Any:
    """Return rclpy's events executor, which wakes up five times faster, or the plain executor.

    The events executor of rclpy 7.1.6 fails for callbacks with message info.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # the first releases of Jazzy
        return SingleThreadedExecutor()
    return SingleThreadedExecutor() if message_info else EventsExecutor()
