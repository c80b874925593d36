"""What is reported to a person in one line instead of a traceback."""

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


class BagError(UserError):
    """A bag, a schema or a message that cannot be written or read.

    The message is one line: it names the file or type and the reason and, where there is
    something to be done about it, what.
    """


def os_reason(error: OSError) -> str:
    """Return what the operating system said, without its number and path."""
    return error.strerror or str(error) or type(error).__name__


def shown(value: object) -> str:
    """Return a value as a person would write it."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(shown(element) for element in value)}]"
    return repr(value)
