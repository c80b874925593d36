"""``quad_mpc compile``: what it does with what is kept, and what it returns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands import compile as command


class Kept:
    """Stands for the machine code on disk."""

    def __init__(self, *, complete: bool = False) -> None:
        self.complete, self.done = complete, list[str]()

    @contextmanager
    def locked(self) -> Iterator[None]:
        yield

    def is_complete(self) -> bool:
        return self.complete

    def count(self) -> int:
        return 7

    def remove_damaged(self) -> int:
        self.done.append("remove damaged")
        return 2

    def remove_all(self) -> None:
        self.complete = False
        self.done.append("remove all")

    def mark_complete(self) -> None:
        self.done.append("mark")


def compiled(
    monkeypatch: pytest.MonkeyPatch, kept: Kept, *options: str, outcomes: tuple[bool, ...] = ()
) -> int:
    results = iter(outcomes)
    monkeypatch.setattr(command, "KeptCode", lambda: kept)
    monkeypatch.setattr(command, "_compile", lambda *_: next(results))
    return main(["compile", *options])


def test_returns_at_once_when_all_is_there(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = Kept(complete=True)
    assert compiled(monkeypatch, kept) == 0
    assert capsys.readouterr().out == "all is compiled\n"
    assert kept.done == []


def test_mends_what_is_damaged(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = Kept()
    assert compiled(monkeypatch, kept, outcomes=(True,)) == 0
    assert kept.done == ["remove damaged", "mark"]
    first, *_, last = capsys.readouterr().out.splitlines()
    assert first == "removed 2 files that are damaged or of an unfinished compilation"
    assert last.startswith("all is compiled: 7 functions, ")


def test_begins_anew_when_asked_to(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(complete=True)
    assert compiled(monkeypatch, kept, "--again", outcomes=(True,)) == 0
    assert kept.done[0] == "remove all"
    assert kept.done[-1] == "mark"


def test_begins_anew_after_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    """The code that crashed may be damaged in a way that no mark knows of."""
    kept = Kept()
    assert compiled(monkeypatch, kept, outcomes=(False, True)) == 0
    assert kept.done == ["remove damaged", "remove all", "mark"]


def test_what_never_compiles_is_not_marked(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept()
    assert compiled(monkeypatch, kept, outcomes=(False, False)) == 1
    assert "mark" not in kept.done


def test_says_where_nothing_can_be_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse() -> None:
        raise OSError("no folder for machine code can be written")

    monkeypatch.setattr(command, "KeptCode", refuse)
    assert main(["compile"]) == 1
    assert "error: no folder for machine code" in capsys.readouterr().err
