"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_LONG_NAME = 7  # letters; shorter names may differ in one letter: mode, node


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is nearest, None if none is near."""
    return next(iter(difflib.get_close_matches(name, list(known), n=1)), None)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the nearest name as ``' (did you mean mpc?)'``; empty if none is near."""
    near = nearest(name, known)
    return f" (did you mean {near}?)" if near else ""


def meant_instead_of(name: str, known: Iterable[str]) -> str | None:
    """Return the known name of which a name is certainly a misspelling, else None.

    A misspelling differs by upper case, ``-`` or ``_``, by two exchanged neighbours, by a doubled
    or missing double letter, or, in a long name, by any one letter. Digits are not misspelt:
    ``mpc2`` may exist besides ``mpc``.
    """
    return next((other for other in known if other != name and _is_slip(name, other)), None)


def _is_slip(name: str, meant: str) -> bool:
    a, b = (text.lower().replace("-", "").replace("_", "") for text in (name, meant))
    if [c for c in a if c.isdigit()] != [c for c in b if c.isdigit()]:
        return False
    if a == b:
        return True
    first = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), None)
    if first is None:
        first = min(len(a), len(b))
    if len(a) == len(b):
        exchanged = a[:first] + a[first : first + 2][::-1] + a[first + 2 :]
        changed = a[first + 1 :] == b[first + 1 :]
        return exchanged == b or (changed and len(meant) >= _LONG_NAME)
    longer, shorter = (a, b) if len(a) > len(b) else (b, a)
    if longer[:first] + longer[first + 1 :] != shorter:
        return False
    # Of equal letters the last differs first.
    doubled = first > 0 and longer[first] == longer[first - 1]
    return doubled or len(meant) >= _LONG_NAME
