"""The one error of this room."""

from __future__ import annotations

from quad_mpc_ros.configuration import UserError


class BagError(UserError):
    """A bag, a schema or a message that cannot be written or read.

    The message is one line: it names the file or type and the reason and, where there is
    something to be done about it, what.
    """


def os_reason(error: OSError) -> str:
    """Return what the operating system said, without its number and path."""
    return error.strerror or str(error) or type(error).__name__
