"""Run nodes from the command line: start, spin, clean end, exit code."""

from __future__ import annotations

import gc
import re
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ParamSpec

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import (
    SignalHandlerOptions,
    install_signal_handlers,
    uninstall_signal_handlers,
)
from rclpy.task import Future

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.ros.parameter_files import (
    read_arguments,
    refuse_own_arguments,
    using_parameters,
)
from quad_mpc_ros.ros.realtime import free_memory, freeze_gc

_P = ParamSpec("_P")

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
# A signal just before the executor waits does not wake it: it ends after this time [s].
_SPIN_TIMEOUT = 1.0
_REPEAT_DELAY = 0.001  # s
_END_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWITCH_INTERVAL = 0.0005  # s; Python's own are 5 ms, a quarter of a control period


def run(
    create: Callable[[], Node], args: list[str] | None = None, *, message_info: bool = False
) -> int:
    """Create a node, spin it until SIGINT, SIGTERM or :func:`stop`, and return the exit code.

    Args:
        create: Creates the node. Its method ``begin``, if any, is called when all nodes exist.
            From then on a signal ends the node with its ``exit_code``, or 0.
            args: Command line arguments for ROS; by default those of the process, which then ends
        with the node.
            message_info: Whether a callback of the node has the message info as an argument.

    Returns:
        The exit code: 2 for an invalid parameter, file or argument, with one line on stderr; 130
        for a signal during the start.
    """
    with _handling_signals(process_ends=args is None) as interrupts:
        return _run([create], args, interrupts, message_info=message_info, only_ros=True)


def run_together(creates: Sequence[Callable[[], Node]], args: list[str] | None = None) -> int:
    """Run several nodes in one process, see :func:`run`; all end when one ends.

    The first node runs in the main thread, each other node in its own thread, so that a slow
    callback does not delay other nodes. The switch interval of threads is 0.5 ms.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL)
    with _handling_signals(process_ends=args is None) as interrupts:
        return _run(creates, args, interrupts)


def _run(
    creates: Sequence[Callable[[], Node]],
    args: list[str] | None,
    interrupts: _Interrupts,
    *,
    message_info: bool = False,
    only_ros: bool = False,
) -> int:
    nodes: list[Node] = []
    threads: list[threading.Thread] = []
    executors: list[Any] = []
    starting = True
    try:
        arguments = sys.argv[1:] if args is None else args
        if only_ros:
            refuse_own_arguments(arguments)
        given = read_arguments(arguments, several=len(creates) > 1)
        _init_ros(args)
        # rclpy's signal thread reads the list of executors without a lock: adding or freeing one
        # meanwhile is a segmentation fault. So executors exist before and after that thread.
        # No multi-threaded executor: a single thread owns the controller.
        executors += [fastest_executor(message_info=message_info) for _ in creates]
        with using_parameters(given):
            for create in creates:
                nodes.append(create())
        starting = False
        known = {
            node.get_fully_qualified_name(): node.get_parameters_by_prefix("") for node in nodes
        }
        given.reject_unused_overrides(known)
        for unread in given.unread_files(known):
            nodes[0].get_logger().warning(unread)
        freeze_gc()
        interrupts.spinning()
        for node in nodes:
            if begin := getattr(node, "begin", None):
                begin()
        for node, executor in zip(nodes, executors, strict=True):
            _register(node, executor)
        install_signal_handlers(SignalHandlerOptions.ALL)
        if not interrupts.received:
            threads += map(_spinning, nodes[1:], executors[1:])
            _spin(executors[0])
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except (KeyboardInterrupt, ExternalShutdownException):
        if starting:
            return EXIT_INTERRUPTED
    except Exception:
        if rclpy.ok() and not interrupts.received:
            raise
        # else a signal came: rclpy fails at the next call
        if starting:
            return EXIT_INTERRUPTED
    finally:
        interrupts.finishing()
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


def _init_ros(args: list[str] | None) -> None:
    """Initialise ROS. Raises :class:`UserError` for invalid arguments."""
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy's own error has no public name
        reason = re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))
        raise UserError(f"ROS refuses the arguments: {reason}") from error


class _Interrupts:
    """Signal handler that interrupts the start once; rclpy's handler ends the spinning.

    An exception inside a callback would print a traceback and leave a message incomplete.
    """

    def __init__(self) -> None:
        self._interrupts = True
        self._number = int(signal.SIGINT)
        self.started = False
        self.received = False
        """Whether a signal was received."""

    def __call__(self, number: int, _frame: object) -> None:
        """Handle a signal."""
        self.received = True
        if self._interrupts:
            self._interrupts, self._number = False, number
            raise KeyboardInterrupt

    def repeat(self, ignored: sys.UnraisableHookArgs) -> None:
        """Interrupt again where Python could not raise: in a C callback or destructor."""
        if ignored.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(ignored)
            return
        while not self.started:
            try:
                self._interrupts = True
                threading.Timer(_REPEAT_DELAY, signal.raise_signal, [self._number]).start()
                return
            except KeyboardInterrupt:  # would be lost here as well
                pass

    def spinning(self) -> None:
        """Stop interrupting: all nodes are started."""
        self._interrupts, self.started = False, True

    def finishing(self) -> None:
        """Ignore further signals, so that files are written completely."""
        self._interrupts = False
        if threading.current_thread() is threading.main_thread():
            for number in _END_SIGNALS:
                signal.signal(number, signal.SIG_IGN)


@contextmanager
def _handling_signals(*, process_ends: bool) -> Iterator[_Interrupts]:
    """Let only the first signal end the start or the spinning.

    A process that continues has its signal handlers restored, also for child processes. A process
    that ends with its node ignores further signals.
    """
    interrupts = _Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield interrupts
        return
    before = {number: signal.getsignal(number) for number in _END_SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupts)
    hook, sys.unraisablehook = sys.unraisablehook, interrupts.repeat
    try:
        yield interrupts
    finally:
        sys.unraisablehook = hook
        if process_ends:
            if not interrupts.started:  # threads of an incomplete node could abort the process
                free_memory()
            gc.freeze()  # else the final collection takes half a second
        for number, handler in before.items() if not process_ends else ():
            # None: not set by Python, and Python cannot restore it.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def stop() -> None:
    """End the spinning node after the current callback."""
    rclpy.try_shutdown()


def until_the_end(node: Node, callback: Callable[_P, None]) -> Callable[_P, None]:
    """Return a callback whose errors are ignored after ROS was shut down."""

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

    The events executor aborts the process if ROS is shut down while it registers. So signals do
    not shut ROS down before.
    """
    executor.add_node(node)
    registered = executor.create_task(lambda: None)  # runs afterwards
    while rclpy.ok() and not registered.done():
        executor.spin_until_future_complete(registered, timeout_sec=_SPIN_TIMEOUT)


def _spin(executor: Any) -> None:
    while rclpy.ok():
        try:
            _spin_some(executor)
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


def _spin_some(executor: Any) -> None:
    if isinstance(executor, SingleThreadedExecutor):
        # Not with a future: each call would add a callback to it.
        executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
    else:
        # Not spin(): the timeout of the events executor of rclpy 7.1.6 overflows on some C
        # libraries and uses a whole core.
        executor.spin_until_future_complete(Future(), timeout_sec=_SPIN_TIMEOUT)
