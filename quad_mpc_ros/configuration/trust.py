"""Whether what is kept in a folder may be loaded: who else could have put it there."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from collections.abc import Iterator
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def distrust(path: Path, *, deep: bool = True) -> str:
    """Return why nothing in a file or folder may be loaded, with its name; empty if it may.

    It and, if ``deep``, all below it have to belong to the user, to root, or to the owner of this
    package, whose code is run anyway, and nobody else may write there. Raises :class:`OSError`
    where it cannot be looked at.
    """
    return next(_faults(path, deep=deep), "")


def _faults(path: Path, *, deep: bool) -> Iterator[str]:
    status = path.stat()
    owners = {os.geteuid(), 0, _PACKAGE.stat().st_uid}
    if status.st_uid not in owners:
        yield f"{path} belongs to {_user(status.st_uid)}"
    if _others_may_write(status):
        yield f"{path} is writable by others"
    if not deep or not stat.S_ISDIR(status.st_mode):
        return
    closed = not status.st_mode & (stat.S_IXGRP | stat.S_IXOTH)
    for inner in sorted(path.iterdir()):
        # What is in a folder that nobody else may enter nobody else can write.
        if not closed or inner.stat().st_uid not in owners:
            yield from _faults(inner, deep=True)


def _others_may_write(status: os.stat_result) -> bool:
    if status.st_mode & stat.S_IWOTH:
        return True
    return bool(status.st_mode & stat.S_IWGRP) and not _is_private(status.st_gid)


def _is_private(group: int) -> bool:
    """Whether a group is the user's alone, by the custom that it has the user's name."""
    try:
        return grp.getgrgid(group).gr_name == pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return False


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"
