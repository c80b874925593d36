"""No condition of the safety ladder can be changed without a test that notices."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from fixtures.scripts import script_module

from quad_mpc_ros.control.safety import ladder

mutation = script_module("test/control/safety/mutation.py")
_stories = script_module("test/control/safety/test_ladder.py")
STORIES: list[Callable[[ModuleType], None]] = [
    story
    for name, story in inspect.getmembers(_stories, inspect.isfunction)
    if name.startswith("test_") and list(inspect.signature(story).parameters) == ["ladder"]
]


def _is_noticed(changed: ModuleType) -> bool:
    for story in STORIES:
        try:
            story(changed)
        except Exception:  # a wrong rung, or no rung at all
            return True
    return False


def test_scenarios_hold_for_the_ladder() -> None:
    assert len(STORIES) > 10
    assert not _is_noticed(ladder)


def test_every_changed_condition_is_noticed() -> None:
    source = Path(inspect.getfile(ladder)).read_text(encoding="utf-8")
    found = list(mutation.mutants(source))
    assert len(found) > 50
    unnoticed = [m.description for m in found if not _is_noticed(m.load())]
    assert unnoticed == []
