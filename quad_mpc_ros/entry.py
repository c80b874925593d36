# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the executables: Ctrl-C ends an executable at once, even during imports.

Python turns SIGINT into an exception, which prints a page of traceback during an import. So the
signal has its default effect, to end the process, until the imported code handles the signal.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Callable

_NODES_PACKAGE = "quad_mpc_ros.ros.nodes"
_OTHER_PROGRAMS = {"quad_mpc": "quad_mpc_ros.cli", "stack_node": "quad_mpc_ros.ros.stack_node"}
_BRIDGE_SUFFIX = "_bridge"


def run(name: str) -> int:
    """Run an executable by its name; return its exit code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if name.endswith(_BRIDGE_SUFFIX):
        return _run_bridge(name)
    return int(importlib.import_module(module_of(name)).main())


def _run_bridge(name: str) -> int:
    registry = importlib.import_module("quad_mpc_ros.ros.bridges.registry")
    node = importlib.import_module("quad_mpc_ros.ros.bridges.node")
    try:
        kind = registry.load_bridge(name)
    except registry.UserError as error:  # a bridge that is not installed
        print(f"error: {error}", file=sys.stderr)
        return 2
    return int(node.run_bridge(kind))


def module_of(name: str) -> str:
    """Return the module with the main function of an executable other than a bridge."""
    return _OTHER_PROGRAMS.get(name, f"{_NODES_PACKAGE}.{name}")


def __getattr__(name: str) -> Callable[[], int]:
    """Return the function of an executable (PEP 562): the functions differ only in name."""
    if name == "quad_mpc" or name.endswith(("_node", _BRIDGE_SUFFIX)):
        return lambda: run(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if __name__ == "__main__":
    sys.exit(run(sys.argv.pop(1)))
