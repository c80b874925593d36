# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run the commands of the pages in an environment with nothing but the package.

    python tools/type_pages.py [--environment FOLDER] [--patience S] [PAGE...]

Takes each block marked ``sh`` (commands) or ``console`` (commands after ``$ ``, each followed by
its output) from README.md and the pages of ``docs/``, and types it line by line, in an empty
folder for each page. README.md and commands that begin with ``make``, ``.venv/`` or
``python bench/`` are typed in a copy of the checkout; commands after ``cd examples`` in its folder
``examples``. A block of YAML, Python or CSV whose fence names a file (```` ```yaml vehicle.yaml
````) is written to that file first.

The environment has a wheel of this checkout installed, as a user would install it; without
``--environment`` the environment is created. A command fails if it exits with an error, prints
other words than the page, prints a traceback, or calls a service that does not answer or refuses.
A command that does not end by itself, like a node, runs during the rest of its block and is then
interrupted. A command that takes longer than ``--patience`` is also interrupted. A flight in real
time whose plans were late is listed as such: the machine was too busy.
If the commands of a block need running nodes and start none, a flight runs next to the commands.
Commands that need something that is not installed (ros2, a flight stack, a firmware) are listed
with the reason and not typed. ``QUAD_MPC_ROS_SETUP`` names a setup file that is sourced for ros2.
The exit code is 1 if a command failed.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STACKS = tuple(sorted((ROOT / "docs/howto/stacks").glob("*.md")))
PAGES = (ROOT / "README.md", *sorted({*(ROOT / "docs").glob("[!ab]*/*.md")} - {*STACKS}))
FENCE = re.compile(r"^```(\w+)(?: +(\S+))?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
OF_THE_CHECKOUT = re.compile(r"make |\.venv/|python (-P )?(bench|examples)/|cd examples$")
STARTS_NODES = re.compile(r"ros2 (run|launch) |quad_mpc fly .*on_request")
RUNS_ON = re.compile(rf"{STARTS_NODES.pattern}|quad_mpc watch(?! --once)")
ASKS_NODES = re.compile(r"ros2 (param|service|lifecycle|topic|bag) |preflight|watch --once")
ANSWERS = re.compile(r"ros2 (param|service|lifecycle) |ros2 topic pub --once ")
FLYING = "quad_mpc fly --set reference.mode=on_request --duration 900"
FLIES = re.compile(r"\d s of \d+ s")  # the progress of quad_mpc fly
RECORDED = (
    "quad_mpc simulate --reference excitation --duration 8 --set simulator.command_delay=0.02"
    " --set simulator.rate_time_constant=0.03 --set simulator.velocity_noise=0.05 --out {path}"
)
CAMPAIGN = "quad_mpc campaign hover --flights 4 --out {path}"
# What the reader has already, by name, and how it comes about here.
THE_READERS_OWN = {
    name: RECORDED.format(path=name)
    for name in (
        "runs/my_flight",
        "runs/square",
        "runs/A",
        "runs/B",
        "runs/before",
        "runs/after",
        "gentle",
    )
} | {
    "vehicle.yaml": "cp {vehicle} vehicle.yaml",
    "my_vehicle.yaml": "cp {vehicle} my_vehicle.yaml",
    "my_bag": RECORDED.format(path="unfinished") + " && cp -r unfinished/bag my_bag",
    "campaigns/baseline": CAMPAIGN.format(path="campaigns/baseline"),
    "campaigns/candidate": CAMPAIGN.format(path="campaigns/candidate") + " --seed 2",
}
OF_THE_SHELL = ("export", "cd", "source")
NEEDS_THE_STACK = "needs the flight stack"
# What cannot be typed here, and why.
ELSEWHERE = {
    r"^make (run|test)": "CI types it",
    r"^QUAD_MPC_\w+=": "needs a firmware",
    r"apt(-get)? |docker |colcon |rosdep ": "needs an installed ROS 2 or a container engine",
    r"^pip install|^python3 -m venv": "the package is installed already",
    r"ros2 security|--enclave|^export ROS_SECURITY|^policies=": "needs sros2",
    r"flight\.mcap": "needs a recording of a flight stack",
    r"/\w+_bridge/|bridge:=|--bridge px4|/fmu/": NEEDS_THE_STACK,
    r"/dev/tty": "needs a serial port",
    r"ros2 run (joy|teleop_twist_\w+|rqt_\w+|diagnostic_aggregator) ": "needs another ROS package",
    r"EFFECT": "a placeholder, for what the table below it lists",
}


@dataclass(frozen=True)
class Typed:
    """A command of a page, its line, and the output on the page."""

    page: Path
    line: int
    command: str
    answer: str = ""

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@dataclass(frozen=True)
class Block:
    """A block of a page: the commands in it, or the text of the file that its fence names."""

    page: Path
    line: int
    commands: tuple[Typed, ...] = ()
    file: str = ""
    text: str = ""


def blocks(page: Path) -> Iterator[Block]:
    """Yield the commands and the files of a page, in order."""
    content = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(content):
        language, file, text = found.groups()
        line = content.count("\n", 0, found.start()) + 2
        if language == "sh":
            typed = tuple(Typed(page, line + at, each) for at, each in commands(text))
            yield Block(page, line, commands=typed)
        elif language == "console":
            yield Block(page, line, commands=tuple(_dialogue(page, line, text)))
        elif file:
            yield Block(page, line, file=file, text=text)


def commands(text: str) -> Iterator[tuple[int, str]]:
    """Yield each command of a shell block with the number of its first line from 0."""
    begun, first = "", 0
    for number, line in enumerate(text.splitlines()):
        first = first if begun else number
        begun += line + "\n"
        if line.endswith("\\") or not _complete(begun):
            continue
        if begun.split("#")[0].strip():
            yield first, begun.strip()
        begun = ""


def _complete(command: str) -> bool:
    try:
        shlex.split(command, comments=True)
    except ValueError:  # a quotation that goes on in the next line
        return False
    return True


def _dialogue(page: Path, line: int, text: str) -> Iterator[Typed]:
    said = re.split(r"^\$ ", text, flags=re.MULTILINE)
    at = line + said[0].count("\n")
    for part in said[1:]:
        (_, command), *_ = commands(part)
        answer = part.strip().removeprefix(command)
        yield Typed(page, at, command, answer.strip())
        at += part.count("\n")


class Reader:
    """A simulated user who types the commands of a page in a folder, one after another."""

    def __init__(self, page: Path, folder: Path, *, options: argparse.Namespace) -> None:
        self.page = page
        self.home = self.folder = folder
        self.checkout = options.checkout
        self.patience = options.patience
        self.settle = options.settle
        self.environment = _environment(options.environment, home=folder)
        self.terminals: list[int] = []
        self.unfinished: list[str] = []
        """What commands would have made that took too long here."""
        self.running: list[tuple[Typed, subprocess.Popen[bytes], Path]] = []
        self.outcomes: list[tuple[str, Typed, str]] = []
        folder.mkdir(parents=True, exist_ok=True)

    def read(self) -> None:
        """Type all that the page says."""
        for block in blocks(self.page):
            if block.file:
                Path(self.folder, block.file).write_text(block.text, encoding="utf-8")
            self.fly_beside(block.commands)
            reason = ""
            for typed in block.commands:
                # What follows a command that needs a flight stack needs it, too.
                reason = self.type(typed, reason if reason == NEEDS_THE_STACK else "")
            self.stop_what_runs_on()

    def fly_beside(self, typed: tuple[Typed, ...]) -> None:
        """Start a flight for commands that ask nodes and start none."""
        reasons = [self.not_here(each.command) for each in typed]
        end = reasons.index(NEEDS_THE_STACK) if NEEDS_THE_STACK in reasons else len(typed)
        here = [each for each, reason in zip(typed[:end], reasons, strict=False) if not reason]
        asks = [each for each in here if ASKS_NODES.search(each.command)]
        starts = any(STARTS_NODES.search(each.command) for each in here)
        if asks and not starts:
            flight = FLYING
            if any("--config vehicle.yaml" in each.command for each in asks):
                flight += " --config vehicle.yaml"
            self.type(Typed(asks[0].page, asks[0].line, flight))

    def type(self, typed: Typed, reason: str = "") -> str:
        """Type a command, unless there is a reason why it cannot be typed here; return that."""
        reason = reason or self.not_here(typed.command)
        if reason:
            self._report("not typed", typed, reason)
            return reason
        if typed.command == "cd examples":
            self.folder = self.checkout / "examples"
        self.provide(typed)
        if RUNS_ON.search(typed.command):
            self.running.append((typed, *self.start(typed.command)))
            self.wait_until_it_answers()
            return ""
        process, log = self.start(typed.command)
        interrupted = self._ends_late(process)
        said = log.read_text(errors="replace")
        problem = _problem(typed, process.returncode, said, interrupted=interrupted)
        if interrupted:
            self.unfinished += re.findall(r"--out (\S+)", typed.command)
        result = "failed" if problem else "interrupted" if interrupted else "ok"
        if process.returncode == 1 and "quad_mpc fly" in typed.command and _was_only_late(said):
            result, problem = "late", "the machine was too busy for a flight in real time"
        self._report(result, typed, problem)
        return ""

    def wait_until_it_answers(self) -> None:
        """Wait until the command that was started last flies, or long enough for a node."""
        typed, process, log = self.running[-1]
        begun = time.monotonic()
        flies = not re.search(r"quad_mpc fly", typed.command)
        while not flies and process.poll() is None and time.monotonic() - begun < self.patience:
            time.sleep(0.5)
            flies = bool(FLIES.search(log.read_text(errors="replace")))
        with suppress(subprocess.TimeoutExpired):
            process.wait(self.settle)

    def not_here(self, command: str) -> str:
        """Return why a command cannot be typed here, empty if it can."""
        for pattern, reason in ELSEWHERE.items():
            if re.search(pattern, command):
                return reason
        for made in self.unfinished:
            if made in command:
                return f"needs {made}, which takes longer than is waited for here"
        program = next((each for each in command.split() if not re.match(r"\w+=", each)), command)
        if program in OF_THE_SHELL:
            return ""
        if "/" not in program and not shutil.which(program, path=self.environment["PATH"]):
            return f"{program} is not installed"
        return ""

    def provide(self, typed: Typed) -> None:
        """Create files that the reader of the page has already, if the command names them."""
        for name, make in THE_READERS_OWN.items():
            missing = not Path(self._folder(typed.command), name).exists()
            if missing and re.search(rf"(?<![\w/]){re.escape(name)}(?![\w.])", typed.command):
                if re.search(rf"--out {re.escape(name)}(?!\S)", typed.command):
                    continue
                vehicle = self.home.parent / "vehicle.yaml"
                vehicle.write_text(_first_vehicle(), encoding="utf-8")
                process, log = self.start(make.format(vehicle=vehicle), like=typed.command)
                if process.wait():
                    raise SystemExit(f"{name} cannot be made:\n{log.read_text()}")

    def stop_what_runs_on(self) -> None:
        """Interrupt, as Ctrl-C does, what did not end by itself."""
        for typed, process, log in reversed(self.running):
            by_itself = process.poll() is not None
            _interrupt(process)
            said = log.read_text(errors="replace")
            problem = _problem(typed, process.returncode, said, interrupted=not by_itself)
            self._report("failed" if problem else "ran on", typed, problem)
        self.running.clear()

    def hang_up(self) -> None:
        """Close the terminals."""
        for end in self.terminals:
            os.close(end)
        self.terminals.clear()

    def start(self, command: str, *, like: str = "") -> tuple[subprocess.Popen[bytes], Path]:
        """Start a command in its own process group, with a log; keep exported variables."""
        log = self.home / f".typed-{time.monotonic_ns()}"
        # A terminal of its own, as a user has, without input while the command runs.
        keyboard, terminal = os.openpty()
        self.terminals += keyboard, terminal
        tty = shlex.quote(os.ttyname(terminal))
        script = f'exec <{tty}\nset -a\n{command}\ncode=$?\nenv -0 > "$KEPT"\nexit $code\n'
        kept = self.home / ".environment"
        self._take_exports(kept)
        with log.open("wb") as output:
            process = subprocess.Popen(
                ["bash", "-c", script],
                cwd=self._folder(like or command),
                env={**self.environment, "KEPT": str(kept)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        return process, log

    def _folder(self, command: str) -> Path:
        whole = self.page == ROOT / "README.md" or OF_THE_CHECKOUT.match(command)
        return self.checkout if whole else self.folder

    def _take_exports(self, kept: Path) -> None:
        if kept.exists():
            entries = (entry.split("=", 1) for entry in kept.read_text().split("\0") if entry)
            self.environment.update((name, value) for name, value in entries if name != "_")

    def _ends_late(self, process: subprocess.Popen[bytes]) -> bool:
        try:
            process.wait(self.patience)
        except subprocess.TimeoutExpired:
            _interrupt(process)
            return True
        except KeyboardInterrupt:
            _interrupt(process)
            raise
        return False

    def _report(self, outcome: str, typed: Typed, detail: str) -> None:
        self.outcomes.append((outcome, typed, detail))
        first, *more = typed.command.splitlines()
        print(f"{outcome:<12}{typed.place:<38} {first}{' …' if more else ''}", flush=True)
        if detail:
            print(f"{'':<12}{detail}", flush=True)


def _environment(environment: Path, *, home: Path) -> dict[str, str]:
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "VIRTUAL_ENV", "AMENT_", "_ROS_WHEELS"))
    }
    setup = kept.get("QUAD_MPC_ROS_SETUP")
    if setup:
        script = '. "$QUAD_MPC_ROS_SETUP" >&2; env -0'
        said = subprocess.run(
            ["bash", "-euc", script],
            env={**kept, "VENV": str(environment)},
            stdout=subprocess.PIPE,
            check=True,
            text=True,
        ).stdout
        kept = dict(entry.split("=", 1) for entry in said.split("\0") if entry)
    return {
        **kept,
        "HOME": str(home),
        "PATH": f"{environment / 'bin'}:{kept['PATH']}",
        "AMENT_PREFIX_PATH": f"{environment}:{kept.get('AMENT_PREFIX_PATH', '')}".rstrip(":"),
        "VENV": str(environment),
        "PYTHONUNBUFFERED": "1",
    }


def _interrupt(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)
    try:
        process.wait(30)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _problem(typed: Typed, code: int, said: str, *, interrupted: bool) -> str:
    """Return the error of a command that ended, empty if there is none."""
    end = f": …{said[-1500:]}"
    script = interrupted and typed.command.startswith("python ")  # where Python says so itself
    if "Traceback (most recent call last)" in said and not script:
        return f"a traceback{end}"
    if interrupted and ANSWERS.match(typed.command):
        return f"no answer{end}"
    if interrupted:
        allowed = (0, 1, 130, -signal.SIGINT, *((2,) if typed.command.startswith("ros2 ") else ()))
        return "" if code in allowed else f"exit code {code} after an interrupt{end}"
    if typed.answer:
        same = _words(typed.answer) in _words(said)
        return "" if same else f"other words than on the page{end}"
    refused = typed.command.startswith("ros2 service call") and "success=False" in said
    return f"exit code {code}{end}" if code else f"the node refuses{end}" if refused else ""


def _was_only_late(said: str) -> bool:
    """Return whether a flight failed because plans took too long, and for no other reason."""
    verdicts = re.findall(r"not active at .*", said)
    late = re.compile(r"not active at \d+ of \d+ ticks: \d+ plan\. First at \S+ s: late: ")
    return bool(verdicts) and all(late.match(each) for each in verdicts)


def _words(text: str) -> str:
    return " ".join(text.split())


def _first_vehicle() -> str:
    page = ROOT / "docs/tutorials/first_flight.md"
    return next(block.text for block in blocks(page) if block.file == "vehicle.yaml")


def _installed(folder: Path) -> Path:
    """Return an environment with a wheel of this checkout and the extras that pages ask for."""
    run = ["bash", "-euc"]
    build = f'tools/in_venv.sh dev python -m build --wheel --outdir "{folder}/dist" . >/dev/null'
    subprocess.run([*run, build], cwd=ROOT, check=True)
    (wheel,) = (folder / "dist").glob("*.whl")
    environment = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    extras = "ros,rotorpy,betaflight,mujoco,campaign,plan"
    pip = [str(environment / "bin" / "pip"), "install", "--quiet", f"{wheel}[{extras}]"]
    subprocess.run(pip, check=True)
    return environment


def _copy_of_the_checkout(folder: Path, environment: Path) -> Path:
    """Return a clone in which ``.venv`` is the environment."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
    (folder / ".venv").symlink_to(environment)
    return folder


def type_pages(pages: tuple[Path, ...], options: argparse.Namespace) -> Counter[str]:
    """Type the pages and return how many commands ended in which way."""
    outcomes: Counter[str] = Counter()
    for page in pages:
        name = "_".join(page.relative_to(ROOT).with_suffix("").parts)
        reader = Reader(page, options.work / name, options=options)
        try:
            reader.read()
        finally:
            reader.stop_what_runs_on()
            reader.hang_up()
        outcomes.update(outcome for outcome, _, _ in reader.outcomes)
    return outcomes


def main() -> int:
    summary, _, text = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(description=summary, epilog=text)
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", help="default: all")
    parser.add_argument("--environment", type=Path, help="where the package is installed")
    parser.add_argument(
        "--patience", type=float, default=120.0, help="s a command is given (default: 120)"
    )
    parser.add_argument(
        "--settle", type=float, default=12.0, help="s until a started node answers (default: 12)"
    )
    options = parser.parse_args()
    # Commands receive Ctrl-C even if this was started in the background, which ignores it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # What was started ends with this, also if this is ended.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    pages = tuple(page.resolve() for page in options.pages) or PAGES + STACKS
    with tempfile.TemporaryDirectory(prefix="typed-") as folder:
        options.work = Path(folder)
        options.environment = (options.environment or _installed(options.work)).resolve()
        options.checkout = _copy_of_the_checkout(options.work / "checkout", options.environment)
        os.environ.setdefault("XDG_CACHE_HOME", str(options.work / "cache"))
        subprocess.run(
            [str(options.environment / "bin" / "quad_mpc"), "compile"],
            env=_environment(options.environment, home=options.work),
            cwd=folder,
            stdout=subprocess.DEVNULL,
            check=True,
        )
        outcomes = type_pages(pages, options)
    print(", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common()))
    return 1 if outcomes["failed"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
