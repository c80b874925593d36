"""The commands of ``quad_mpc``, a module or a package each, and the exit codes they end with.

``add_options(parser)`` says what a command can be given and what it does, ``run(options)`` does it
and returns the exit code. A module is imported when its command is asked for; what takes long to
import, ``run`` imports, so that ``--help`` is quick. May import everything.
"""

EXIT_FAILED = 1
"""A flight with failsafe, or a reference that cannot be flown."""
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
"""The reader closed the output, as ``head`` does; a shell reports SIGPIPE in this way."""
