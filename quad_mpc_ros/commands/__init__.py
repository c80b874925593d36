# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands of ``quad_mpc``, one module each, and exit codes.

``add_options(parser)`` adds the options and the description of a command, ``run(options)`` runs
the command and returns the exit code. Only the module of the given command is imported. ``run``
itself imports slow modules, so that ``--help`` is fast.
"""

EXIT_FAILED = 1
"""A flight with failsafe, or a reference that cannot be flown."""
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
"""The reader closed the output, as ``head`` does; a shell reports SIGPIPE in this way."""
