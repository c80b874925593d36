# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_LONG_NAME = 7  # letters; shorter names may differ in one letter: mode, node


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the nearest name as ``' (did you mean mpc?)'``; empty if no name is near."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def meant_instead_of(name: str, known: Iterable[str]) -> str | None:
    """Return the known name if a name is certainly its misspelling, else None.

    A misspelling differs by upper case, ``-`` or ``_``, by two exchanged neighbours, by a doubled
    or missing double letter, or, in a long name, by any one letter. Digits are not misspelt:
    ``mpc2`` may exist in addition to ``mpc``.
    """
    return next((other for other in known if other != name and _is_slip(name, other)), None)


def _is_slip(name: str, meant: str) -> bool:
    a, b = (text.lower().replace("-", "").replace("_", "") for text in (name, meant))
    if [c for c in a if c.isdigit()] != [c for c in b if c.isdigit()]:
        return False
    if re.sub(r"(.)\1+", r"\1", a) == re.sub(r"(.)\1+", r"\1", b):  # doubled letters
        return True
    if any(a[:i] + a[i + 1] + a[i] + a[i + 2 :] == b for i in range(len(a) - 1)):
        return True
    return len(meant) >= _LONG_NAME and not _shortened(a).isdisjoint(_shortened(b))


def _shortened(text: str) -> set[str]:
    """Return a text, and all variants with one letter removed."""
    return {text, *(text[:i] + text[i + 1 :] for i in range(len(text)))}
