"""What is reported to a person in one line instead of a traceback."""

from __future__ import annotations

_LONGEST = 300  # characters that are shown of a value


class UserError(Exception):
    """Something the user gave cannot be used; commands end with exit code 2 on it.

    The message is one line: what was given, what was expected, what to do.
    """


class ArgumentError(UserError, ValueError):
    """An argument that cannot be used, with its name, what was given and what was expected."""

    def __init__(self, name: str, given: object, expected: str) -> None:
        super().__init__(f"{name}: given {readable(given)}, expected {expected}")
        self.name = name
        self.given = given
        self.expected = expected

    def located(self, where: str) -> ConfigurationError:
        """Return the same error, its message beginning with where the value is from."""
        return self._saying(f"{where}: {self}")

    def of_option(self, option: str) -> ConfigurationError:
        """Return the same error, by the name of the option that gave the value."""
        return self._saying(str(self).replace(self.name, option, 1))

    def _saying(self, message: str) -> ConfigurationError:
        other = ConfigurationError(self.name, self.given, self.expected)
        other.args = (message,)
        return other


class ConfigurationError(ArgumentError):
    """A parameter that cannot be used, with its name, the value given and what is allowed."""


class BagError(UserError):
    """A bag, a schema or a message that cannot be written or read.

    The message is one line: it names the file or type and the reason and, where there is
    something to be done about it, what.
    """


def os_reason(error: OSError) -> str:
    """Return what the operating system said, without its number and path."""
    return error.strerror or str(error) or type(error).__name__


def readable(value: object) -> str:
    """Return a value as a person would write it, in one line; of an array type and shape."""
    if isinstance(value, list | tuple):
        return _shortened(f"[{', '.join(readable(element) for element in value[:_LONGEST])}]")
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array {value.shape} of {value.dtype}" if value.shape else str(value)
    try:
        return _shortened(" ".join(repr(value).split()))
    except Exception:  # an object's own doing, or an integer too long for Python to write
        return f"a {type(value).__name__}"


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
