"""Running nodes from the command line: start, spin, end cleanly, exit code."""

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
# A signal that comes just before the executor waits does not wake it; then it ends this late.
_SPIN_TIMEOUT = 1.0
_REPEAT_DELAY = 0.001  # s
_END_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWITCH_INTERVAL = 0.0005  # s; Python's own are 5 ms, a quarter of a control period


def run(
    create: Callable[[], Node], args: list[str] | None = None, *, message_info: bool = False
) -> int:
    """Make a node, spin it until SIGINT, SIGTERM or :func:`stop`, and return the exit code.

    Args:
        create: Makes the node. Its ``begin``, if it has one, is called when all is made: what
            others see of the node comes after it, and from then on a signal ends it with its
            ``exit_code``, 0 if it has none.
        args: Command line arguments for ROS; those of the process if not given, which then ends
            with the node.
        message_info: Whether a callback of the node takes the message's info as well.

    Returns:
        The exit code: 2 for a wrong parameter, file or argument, which is one line on stderr, and
        130 when it was asked to end while it was still starting.
    """
    with _handling_signals(process_ends=args is None) as interrupts:
        return _run([create], args, interrupts, message_info=message_info, only_ros=True)


def run_together(creates: Sequence[Callable[[], Node]], args: list[str] | None = None) -> int:
    """Make nodes in one process, as :func:`run` does one, and end all when one ends.

    The first has the main thread, each of the others one of its own: what takes one of them long
    is not to delay another. The thread that runs changes every half a millisecond at most.
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
        # rclpy's signal thread reads the list of executors without a lock: one that is added or
        # freed meanwhile is a segmentation fault. So they exist before and after that thread.
        # Never the multi-threaded executor: a single thread owns the controller.
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
        # else asked to end meanwhile: rclpy then fails at whatever comes next
        if starting:
            return EXIT_INTERRUPTED
    finally:
        interrupts.finishing()
        uninstall_signal_handlers()  # returns when the signal thread has ended
        if threads:
            rclpy.try_shutdown()  # which ends their spinning
        for thread in threads:
            thread.join()
        executors.clear()
        exit_codes = [0]
        for node in reversed(nodes):
            node.destroy_node()
            exit_codes.append(int(getattr(node, "exit_code", 0)))
            # A lifecycle node keeps its part of DDS, threads and all, as long as it exists, and
            # refers to itself. To collect it as garbage would take longer than all the rest.
            vars(node).clear()
        rclpy.try_shutdown()
    return max(exit_codes)


def _init_ros(args: list[str] | None) -> None:
    """Start ROS; raise :class:`UserError` for arguments that it does not take."""
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # of rclpy, which gives its own no public name
        reason = re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))
        raise UserError(f"ROS refuses the arguments: {reason}") from error


class _Interrupts:
    """What a signal does: it interrupts what starts, once. Spinning is ended by rclpy's handler.

    For an exception in the middle of a callback would be a page of traceback, and half a message.
    """

    def __init__(self) -> None:
        self._interrupts = True
        self._number = int(signal.SIGINT)
        self.started = False
        self.received = False
        """Whether a signal has come."""

    def __call__(self, number: int, _frame: object) -> None:
        """Hear a signal."""
        self.received = True
        if self._interrupts:
            self._interrupts, self._number = False, number
            raise KeyboardInterrupt

    def repeat(self, ignored: sys.UnraisableHookArgs) -> None:
        """Interrupt again where Python could not raise: in a callback of C, in a destructor."""
        if ignored.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(ignored)
            return
        while not self.started:
            try:
                self._interrupts = True
                threading.Timer(_REPEAT_DELAY, signal.raise_signal, [self._number]).start()
                return
            except KeyboardInterrupt:  # raised here, where it would be lost as well
                pass

    def spinning(self) -> None:
        """Interrupt no more: all is started."""
        self._interrupts, self.started = False, True

    def finishing(self) -> None:
        """Hear no more signals: what is written out stays whole."""
        self._interrupts = False
        if threading.current_thread() is threading.main_thread():
            for number in _END_SIGNALS:
                signal.signal(number, signal.SIG_IGN)


@contextmanager
def _handling_signals(*, process_ends: bool) -> Iterator[_Interrupts]:
    """Let the first signal end a start, or the spinning, and no further one.

    A process that goes on hears signals afterwards as before, and so does what it starts, which
    inherits what is ignored. One that ends with its node hears none any more.
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
            if not interrupts.started:  # a node may be half made, and its threads abort a process
                free_memory()
            gc.freeze()  # or Python looks through everything once more, for half a second
        for number, handler in before.items() if not process_ends else ():
            # None: not of Python, nor can Python set it again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def stop() -> None:
    """Let the spinning node end after the callback that runs now."""
    rclpy.try_shutdown()


def until_the_end(node: Node, callback: Callable[_P, None]) -> Callable[_P, None]:
    """Return a callback of a node that may fail when ROS has ended: nothing is published then."""

    def guarded(*arguments: _P.args, **named: _P.kwargs) -> None:
        try:
            callback(*arguments, **named)
        except Exception:
            if node.context.ok():
                raise

    return guarded


def _spinning(node: Any, executor: Any) -> threading.Thread:
    """Return a thread that spins a node; a defect of it ends all of the process."""

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
    """Add a node to an executor, and let that register for all that the node has.

    If ROS ends while the events executor registers, it aborts the process. So a signal does not
    end ROS before.
    """
    executor.add_node(node)
    registered = executor.create_task(lambda: None)  # is run after that
    while rclpy.ok() and not registered.done():
        executor.spin_until_future_complete(registered, timeout_sec=_SPIN_TIMEOUT)


def _spin(executor: Any) -> None:
    while rclpy.ok():
        try:
            _spin_some(executor)
        except RuntimeError:  # of rclpy
            if rclpy.ok():
                raise  # else a signal came while the plain executor prepared to wait


def fastest_executor(*, message_info: bool) -> Any:
    """Return rclpy's events executor, which wakes in a fifth of the time, or the plain one.

    The events executor of rclpy 7.1.6 fails on callbacks that take the message's info as well.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:  # the first releases of Jazzy
        return SingleThreadedExecutor()
    return SingleThreadedExecutor() if message_info else EventsExecutor()


def _spin_some(executor: Any) -> None:
    if isinstance(executor, SingleThreadedExecutor):
        # Not until a future completes: it would be given one more callback at every wake-up.
        executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
    else:
        # Not spin(): without a timeout the events executor of rclpy 7.1.6 waits until the end of
        # time, which overflows on some C libraries and burns a whole core.
        executor.spin_until_future_complete(Future(), timeout_sec=_SPIN_TIMEOUT)
