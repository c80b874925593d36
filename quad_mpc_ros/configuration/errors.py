# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors that are reported in one line instead of a traceback."""

from __future__ import annotations

_MAX_LENGTH = 300  # characters of a value


class UserError(Exception):
    """Unusable input of the user; commands exit with code 2.

    The message is one line with the given input, the expected input and the remedy.
    """


class ArgumentError(UserError, ValueError):
    """An unusable argument, with name, given value and expected value."""

    def __init__(self, name: str, given: object, expected: str) -> None:
        super().__init__(f"{name}: given {text_of(given)}, expected {expected}")
        self.name = name
        self.given = given
        self.expected = expected

    def located(self, where: str) -> ConfigurationError:
        """Return the same error with the origin of the value before the message."""
        other = ConfigurationError(self.name, self.given, self.expected)
        other.args = (f"{where}: {self}",)
        return other


class ConfigurationError(ArgumentError):
    """An unusable parameter, with name, given value and allowed values."""


class BagError(UserError):
    """A bag, a schema or a message that cannot be written or read.

    The message is one line with the file or type, the reason and, if possible, a remedy.
    """


def os_reason(error: OSError) -> str:
    """Return the message of the operating system, without its number and path."""
    return error.strerror or str(error) or type(error).__name__


def text_of(value: object) -> str:
    """Return a value as readable text in one line; type and shape of an array."""
    if isinstance(value, list | tuple):
        return _shortened(f"[{', '.join(text_of(element) for element in value[:_MAX_LENGTH])}]")
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array {value.shape} of {value.dtype}" if value.shape else str(value)
    try:
        return _shortened(" ".join(repr(value).split()))
    except Exception:  # by the object's repr, or an integer with too many digits
        return f"a {type(value).__name__}"


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_LENGTH else f"{text[: _MAX_LENGTH - 3]}..."
