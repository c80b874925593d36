# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Suggestions for misspelt names."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_LONG_NAME = 7  # letters; shorter names may differ in one letter: mode, node
_CERTAIN = 0.85  # similarity: one letter of seven


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the nearest name as ``' (did you mean mpc?)'``; empty if no name is near."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def meant_instead_of(name: str, known: Iterable[str]) -> str | None:
    """Return the known name if a name is certainly its misspelling, else None.

    A misspelling has the same letters in another order, case or number, or differs little from a
    long name. Digits are not misspelt: ``mpc2`` may exist in addition to ``mpc``.
    """
    for other in known:
        a, b = (re.sub(r"[_-]|(.)(?=\1)", "", text.lower()) for text in (name, other))
        if re.findall(r"\d", a) != re.findall(r"\d", b):
            continue
        near = difflib.SequenceMatcher(None, a, b).ratio() > _CERTAIN
        if sorted(a) == sorted(b) or (near and len(b) >= _LONG_NAME):
            return other
    return None
