# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The commands of the pages exist: options, executables, launch files, presets, names.

``tools/type_pages.py`` executes the commands; these tests only parse them, which is fast.
"""

from __future__ import annotations

import argparse
import itertools
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.scripts import ROOT, script_module
from fixtures.setup_py import declared

from quad_mpc_ros.cli import COMMANDS, parser_for
from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration.files import presets, shipped

pages = script_module("tools/type_pages.py")
TYPED = [
    typed
    for page in pages.PAGES + pages.STACKS
    for block in pages.blocks(page)
    for typed in block.commands
]
PLACEHOLDER = "EFFECT"


def words(command: str) -> list[str]:
    return shlex.split(command.replace("\\\n", " "), comments=True)


OF_QUAD_MPC = [
    each
    for each in TYPED
    if re.match(r"(\.venv/bin/)?quad_mpc ", each.command) and PLACEHOLDER not in each.command
]
OF_ROS2 = [each for each in TYPED if each.command.startswith("ros2 ")]


def wrong(check: Callable[[Any], None], typed: list[Any]) -> list[str]:
    """Return what a check has against command lines, with the place of each."""
    found = []
    for each in typed:
        try:
            check(each)
        except (AssertionError, SystemExit) as error:
            found.append(f"{each.place}: {each.command}: {error}")
    return found


def test_every_command_line_takes_its_options() -> None:
    assert wrong(takes_its_options, OF_QUAD_MPC) == []


def takes_its_options(typed: Any) -> None:
    command, *given = words(typed.command)[1:]
    assert command in COMMANDS
    options = parser_for([command]).parse_args([command, *given])
    for assignment in getattr(options, "assignments", None) or ():
        node, _, name = assignment.partition("=")[0].partition(".")
        assert name in {spec.name for spec in SCHEMA[node].specs()}, assignment


def test_executables_of_ros2_run_exist() -> None:
    assert wrong(is_found_by_ros2, OF_ROS2) == []


def is_found_by_ros2(typed: Any) -> None:
    _, verb, *rest = words(typed.command)
    if verb == "run" and rest[0] == "quad_mpc_ros":
        assert rest[1] in declared("console_scripts")
    if verb == "launch":
        assert (ROOT / "launch" / rest[1]).is_file()


def test_files_of_commands_exist_in_the_package_or_on_the_page() -> None:
    assert wrong(has_its_files, OF_QUAD_MPC) == []


def has_its_files(typed: Any) -> None:
    given = words(typed.command)
    made = {
        word
        for each in TYPED
        if each.page == typed.page
        for option, word in itertools.pairwise(words(each.command))
        if option == "--out"
    }
    written = {block.file for block in pages.blocks(typed.page) if block.file}
    known = {*presets(), *shipped("campaigns"), *written, *made, *pages.THE_READERS_OWN}
    named = [
        word
        for option, word in itertools.pairwise(given)
        if re.search(r"\.(yaml|py|csv)$", word)
        or (option in ("--config", "campaign", "tune") and not word.startswith("-"))
    ]
    for word in (name.rpartition("=")[2] for name in named):
        inside = any(word.startswith(f"{folder}/") for folder in made)
        of_the_sources = (ROOT / word).is_file() and pages.OF_THE_CHECKOUT.match(typed.command)
        assert word in known or inside or of_the_sources or "many.yaml" in word, word


def test_blocks_of_commands_are_marked() -> None:
    """``tools/type_pages.py`` does not execute unmarked blocks."""
    for page in pages.PAGES + pages.STACKS:
        for text in re.findall(r"^```text\n(.*?)^```", Path(page).read_text(), re.S | re.M):
            assert not re.match(r"(\.venv/bin/)?(quad_mpc|ros2|pip) ", text), (page, text)


def test_continued_lines_are_one_command() -> None:
    text = "a --b \\\n  c\n# said\nd '{x:\n  y}'   # why\n"
    assert list(pages.commands(text)) == [(0, "a --b \\\n  c"), (3, "d '{x:\n  y}'   # why")]


ROS2 = """#!/bin/sh
case "$3" in
  /silent) exec sleep 600 ;;
  /refused) echo "response: Trigger_Response(success=False, message='too late')" ;;
  *) echo "response: Trigger_Response(success=True, message='')" ;;
esac
"""


@pytest.mark.parametrize(
    ("block", "problem"),
    [
        ("```sh\ntrue   # why\n```\n", ""),
        ("```sh\nfalse\n```\n", "exit code 1"),
        ("```sh\necho Traceback '(most recent call last):'\n```\n", "a traceback"),
        ("```console\n$ echo 2  gates\n2 gates\n```\n", ""),
        ("```console\n$ echo 3 gates\n2 gates\n```\n", "other words than on the page"),
        ("```csv points.csv\n1, 2\n```\n\n```sh\ngrep 2 points.csv\n```\n", ""),
        ("```sh\ncat missing.csv\n```\n", "exit code 1"),
        ("```sh\nexport MASS=3\ntest $MASS = 3\n```\n", ""),
        ("```sh\nros2 service call /accepted std_srvs/srv/Trigger\n```\n", ""),
        ("```sh\nros2 service call /refused std_srvs/srv/Trigger\n```\n", "the node refuses"),
        ("```sh\nros2 service call /silent std_srvs/srv/Trigger\n```\n", "no answer"),
    ],
)
def test_type_pages_reports_commands_that_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: str, problem: str
) -> None:
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.setattr(pages, "ASKS_NODES", re.compile("never"))  # no flight beside the commands
    ros2 = tmp_path / "environment" / "bin" / "ros2"
    ros2.parent.mkdir(parents=True)
    ros2.write_text(ROS2)
    ros2.chmod(0o755)
    page = tmp_path / "page.md"
    page.write_text(block)
    options = argparse.Namespace(
        checkout=tmp_path,
        environment=tmp_path / "environment",
        patience=0.5 if "silent" in block else 60.0,
        settle=0.0,
    )
    reader = pages.Reader(page, tmp_path / "typed", options=options)
    reader.read()
    reader.hang_up()
    assert [outcome for outcome, _, _ in reader.outcomes][-1:] == ["failed" if problem else "ok"]
    assert reader.outcomes[-1][2].startswith(problem)
