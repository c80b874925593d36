"""Kept machine code as a whole: its mark, and files that are damaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.configuration import kept_code
from quad_mpc_ros.configuration.kept_code import KeptCode

INDEX, CODE = "motion.step-12.py311.nbi", "motion.step-12.py311.1.nbc"
OTHER = "motion.advance-90.py311.1.nbc"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which three files are kept."""
    made = tmp_path / "compiled-digest"
    for name in (INDEX, CODE, OTHER):
        (made / "motion_1").mkdir(parents=True, exist_ok=True)
        (made / "motion_1" / name).write_bytes(name.encode())
    monkeypatch.setattr(kept_code, "cache_folder", lambda _: made)
    return made / "motion_1"


def test_without_a_mark_nothing_is_trusted(folder: Path) -> None:
    kept = KeptCode()
    assert kept.count() == 2
    assert not kept.is_complete()
    assert kept.remove_damaged() == 3
    assert not list(folder.iterdir())


def test_is_complete_once_marked(folder: Path) -> None:
    KeptCode().mark_complete()
    kept = KeptCode()
    assert kept.is_complete()
    assert kept.remove_damaged() == 0
    (folder / "motion.land-7.py311.1.nbc").touch()  # a node has compiled more
    assert kept.is_complete()


@pytest.mark.parametrize("name", [INDEX, CODE])
def test_a_function_with_a_damaged_file_is_removed(folder: Path, name: str) -> None:
    KeptCode().mark_complete()
    content = bytearray((folder / name).read_bytes())
    content[3] ^= 1
    (folder / name).write_bytes(content)
    kept = KeptCode()
    assert not kept.is_complete()
    assert kept.remove_damaged() == 2
    assert [file.name for file in folder.iterdir()] == [OTHER]


def test_a_missing_file_is_noticed(folder: Path) -> None:
    KeptCode().mark_complete()
    (folder / OTHER).unlink()
    assert not KeptCode().is_complete()


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"written\nno checksum"])
def test_a_damaged_mark_marks_nothing(folder: Path, content: bytes) -> None:
    KeptCode().mark_complete()
    (mark,) = folder.parents[1].glob("complete-*")
    mark.write_bytes(content)
    assert not KeptCode().is_complete()


def test_sources_that_were_written_again_are_noticed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba compiles again then, even if their content is the same."""
    package = tmp_path / "package"
    package.mkdir()
    (package / "motion.py").write_text("@compiled")
    monkeypatch.setattr(kept_code, "PACKAGE", package)
    KeptCode().mark_complete()
    assert KeptCode().is_complete()
    (package / "motion.py").write_text("@compiled")
    assert not KeptCode().is_complete()


def test_everything_can_be_removed(folder: Path) -> None:
    KeptCode().mark_complete()
    kept = KeptCode()
    kept.remove_all()
    assert kept.count() == 0
    assert not kept.is_complete()
