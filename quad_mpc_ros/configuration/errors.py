"""What is told to a person in one line instead of a traceback."""

from __future__ import annotations


class UserError(Exception):
    """Something the user gave cannot be used; commands end with exit code 2 on it.

    The message is one line: what was given, what was expected, what to do.
    """


class ConfigurationError(UserError, ValueError):
    """A parameter that cannot be used, with its name, the value given and what is allowed."""

    def __init__(self, name: str, given: object, expected: str) -> None:
        super().__init__(f"{name}: given {shown(given)}, expected {expected}")
        self.name = name
        self.given = given
        self.expected = expected


def shown(value: object) -> str:
    """Return a value as a person would write it."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(shown(element) for element in value)}]"
    return repr(value)
