# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Mutate every kind of file that the package reads: each is read, or refused in one line.

    python bench/fuzz_files.py [--count 10000] [--seed 43] [--kind NAME] [--keep DIR]

Every mutation is read in this process by what a command reads it with. Anything but a result or a
:class:`UserError` of one line is a failure: a traceback, an exit code other than 0, 1 and 2, exit
code 2 without a line, a warning of NumPy, more than 20 s. Failures are written to ``--keep``.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import random
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from fixtures.mutations import mutated_bytes, mutated_text

from quad_mpc_ros import cli
from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.extras.campaigns.campaign_file import read_campaign
from quad_mpc_ros.extras.campaigns.tuning.tune_file import read_tuning
from quad_mpc_ros.extras.obstacles.files import read_scene
from quad_mpc_ros.extras.obstacles.surfaces import area, surface_points
from quad_mpc_ros.extras.racing.gates import course_text, read_course
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.repair import repair
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import judged_trajectory
from quad_mpc_ros.references.motion_table import MotionTable

_PATIENCE = 20  # s
_LONGEST = 10_000  # characters of an error: some list every parameter
_CSV = "time [s], x [m], y [m], z [m], yaw [rad]\n" + "".join(
    f"{0.2 * k:.1f}, {0.1 * k * (9 - k):.2f}, {0.2 * k:.1f}, 1.0, 0.1\n" for k in range(10)
)
_OBSTACLES = (
    "obstacles:\n"
    "  - {shape: box, position: [4.0, 0.0, 1.5], size: [0.4, 0.4, 3.0], yaw: 0.3}\n"
    "  - {shape: cylinder, position: [6.0, 1.0, 1.0], radius: 0.2, height: 2.0}\n"
    "  - {shape: sphere, position: [8.0, 0.0, 2.0], radius: 0.5, velocity: [0.0, 1.0, 0.0]}\n"
    "volume: {minimum: [-1.0, -5.0, 0.0], maximum: [12.0, 5.0, 4.0]}\n"
)
_CAMPAIGN = (
    "flights: 20\nseed: 3\nconfig: [default]\nreference: hover\nduration: 4.0\nset:\n"
    "  mpc.mass: 0.5\nvary:\n  simulator.mass_scale: {uniform: [0.9, 1.1]}\n"
    "  simulator.wind: {uniform: [[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]]}\n"
    "  mpc.rate_time_constant: {choice: [0.02, 0.04]}\n"
)
_TUNING = (
    "trials: 3\ncampaigns:\n"
    "  one: {flights: 2, vary: {simulator.mass_scale: {uniform: [0.9, 1.1]}}}\n"
    "search:\n  mpc.terminal_weight: {uniform: [1.0, 2.0]}\n"
    "objectives:\n- {campaign: one, figure: position_rmse_m, of: median}\n"
)
_PARAMETERS = (
    "/**:\n  ros__parameters:\n    mass: 0.8\n    thrust_curve: [1.9, 2.8, -0.005]\n"
    "mpc:\n  ros__parameters:\n    limits: {tilt_max: 0.6}\n    R: [0.0, 0.1, 0.1, 0.1]\n"
    "uav1/simulator:\n  ros__parameters: {seed: 3, dynamics: rigid_body}\n"
)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of file: sound ones, how a copy is mutated, and what reads it."""

    name: str
    sound: Callable[[], list[Path]]
    read: Callable[[Path], object]
    is_text: bool = True
    mutated: str = ""
    """The file of a folder that is mutated; empty where the file stands alone."""


def kinds(folder: Path) -> list[Kind]:
    """Return the kinds, which write sound files into a folder when they are asked for them."""

    def texts(stem: str, *contents: str, ending: str = "yaml") -> Callable[[], list[Path]]:
        paths = [folder / f"{stem}{number}.{ending}" for number in range(len(contents))]
        for path, content in zip(paths, contents, strict=True):
            path.write_text(content)
        return lambda: paths

    shipped = files.presets()
    vehicles = [path.read_text() for name, path in shipped.items() if "/" in name]
    gates = [path.read_text() for path in files.shipped("gates").values()]
    bags = functools.cache(lambda: [_bag(folder)])

    def unchecked() -> list[Path]:
        return [_unchecked(*bags())]

    return [
        Kind(name="parameters", sound=texts("parameters", _PARAMETERS), read=_load),
        Kind(name="vehicle", sound=texts("vehicle", *vehicles), read=_load),
        Kind(name="gates", sound=texts("gates", *gates), read=_gates),
        Kind(name="obstacles", sound=texts("obstacles", _OBSTACLES), read=_scene),
        Kind(name="campaign", sound=texts("campaign", _CAMPAIGN), read=_campaign),
        Kind(name="tune", sound=texts("tune", _TUNING), read=read_tuning),
        Kind(name="points", sound=texts("points", _CSV, ending="csv"), read=_judged("csv")),
        Kind(
            name="motion",
            sound=texts("race", _motion().text(), ending="csv"),
            read=_judged("csv"),
        ),
        Kind(
            name="metadata.yaml",
            sound=bags,
            read=_bag_commands,
            mutated="metadata.yaml",
        ),
        Kind(
            name="mcap",
            sound=bags,
            read=_bag_commands,
            mutated="bag_0.mcap",
            is_text=False,
        ),
        Kind(
            name="mcap unchecked",
            sound=unchecked,
            read=_single_bag,
            is_text=False,
        ),
        Kind(name="db3", sound=lambda: [_db3(folder)], read=_single_bag, is_text=False),
    ]


def fuzz(
    kind: Kind, *, count: int, seed: int, folder: Path, keep: Path | None = None
) -> tuple[Counter[str], list[str]]:
    """Return the outcomes of mutations of a kind, and a line for each failure."""
    rng = random.Random(f"{kind.name} {seed}")
    sounds, outcomes = kind.sound(), Counter[str]()
    failures = []
    for number in range(count):
        sound = rng.choice(sounds)
        path = folder / f"mutated{sound.suffix}"
        if sound.is_dir():
            shutil.rmtree(path, ignore_errors=True)
            shutil.copytree(sound, path)
        file = path / kind.mutated if kind.mutated else path
        data = (sound / kind.mutated if kind.mutated else sound).read_bytes()
        made = mutated_text(data.decode(), rng) if kind.is_text else mutated_bytes(data, rng)
        file.write_bytes(made)
        outcome = _outcome(kind, path)
        outcomes[outcome.partition(":")[0]] += 1
        if outcome not in ("read", "refused"):
            failures.append(f"{kind.name} {number}: {outcome}")
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{kind.name.replace(' ', '_')}_{number}{file.suffix}").write_bytes(made)
    return outcomes, failures


def _outcome(kind: Kind, path: Path) -> str:
    try:
        with _patience(), warnings.catch_warnings():
            warnings.simplefilter("error")
            kind.read(path)
    except UserError as error:
        text = str(error)
        printable = text == text.splitlines()[0] if text else False
        return "refused" if printable and len(text) < _LONGEST else f"not one line: {text[:300]!r}"
    except Exception as error:
        where = error.__traceback__
        while where is not None and where.tb_next is not None:
            where = where.tb_next
        place = "" if where is None else f"{where.tb_frame.f_code.co_filename}:{where.tb_lineno}"
        return f"{type(error).__name__}: {str(error)[:200]!r} at {place}"
    return "read"


@contextlib.contextmanager
def _patience() -> Iterator[None]:
    def give_up(_number: int, _frame: object) -> None:
        raise TimeoutError("it takes too long")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(_PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _load(path: Path) -> None:
    files.load([str(path)], [], schema=SCHEMA)


def _gates(path: Path) -> None:
    read_course(path)
    read_course(course_text(path))


def _scene(path: Path) -> None:
    scene = read_scene(path)
    scene.clearances(np.zeros((3, 3)), np.array([0.0, 1.0, 2.0]))
    for shape in scene.shapes:
        if area(shape) < 100.0:
            surface_points(shape, 0.1)


def _campaign(path: Path) -> None:
    campaign = read_campaign(path)
    for number in range(min(campaign.flights, 3)):
        campaign.configured(campaign.drawn(number))


def _judged(trajectory: str) -> Callable[[Path], None]:
    def judge(path: Path) -> None:
        judged_trajectory(ReferenceConfig(trajectory=trajectory, file=str(path)))

    return judge


def _bag_commands(path: Path) -> None:
    """Read a bag as ``report`` and ``resolve`` do; repair it."""
    refusal: UserError | None = None
    for read in (_report, lambda each: Recording(each).run()):
        try:
            read(path)
        except UserError as error:
            refusal = error
    try:
        repair(path)
    except UserError as error:
        refusal = error
    else:
        BagReader(path)
        if repair(path) is not None:
            raise AssertionError("a repaired bag needs another repair")
    if refusal is not None:
        raise refusal


def _single_bag(path: Path) -> None:
    for broken in path.parent.glob("mutated*.broken"):
        broken.unlink()
    _bag_commands(path)


def _report(path: Path) -> None:
    summarise(Recording(path).flight())


def _motion() -> MotionTable:
    t = np.linspace(0.0, 2.0, 21)
    x, v, a = 1.0 - np.cos(np.pi * t), np.pi * np.sin(np.pi * t), np.pi**2 * np.cos(np.pi * t)
    zero = np.zeros_like(t)
    return MotionTable(
        source="made",
        seconds=t,
        p_WB=np.column_stack((x, zero, zero + 1.0)),
        v_WB_W=np.column_stack((v, zero, zero)),
        a_WB_W=np.column_stack((a, zero, zero)),
        q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (21, 1)),
        w_WB_B=np.zeros((21, 3)),
    )


def _bag(folder: Path) -> Path:
    """Return a recorded flight of a second."""
    out = folder / "run"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        cli.main(["simulate", "--duration", "0.2", "--out", str(out)])
    shutil.rmtree(out / "figures", ignore_errors=True)
    return out / "bag"


def _unchecked(bag: Path) -> Path:
    """Return the file of a bag again, without checksums, so that messages are broken as well."""
    file = bag.with_name("unchecked.mcap")
    with (bag / "bag_0.mcap").open("rb") as source, file.open("wb") as stream:
        writer = Writer(
            stream, compression=CompressionType.NONE, use_chunking=False, enable_crcs=False
        )
        writer.start(profile="ros2")
        numbers: dict[int, int] = {}
        reader = make_reader(source)
        for schema, channel, message in reader.iter_messages():
            if channel.id not in numbers:
                assert schema is not None
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                numbers[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()
    return file


def _db3(folder: Path) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    with Writer(folder / "sqlite", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        clock = "rosgraph_msgs/msg/Clock"
        connection = writer.add_connection(
            "/clock", clock, typestore=get_typestore(Stores.ROS2_JAZZY)
        )
        writer.write(connection, 1, b"\x00\x01\x00\x00" + bytes(8))
    return folder / "sqlite" / "sqlite.db3"


def main() -> int:
    """Fuzz every kind, print a table; return 1 if anything ended wrongly."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="mutations of each kind")
    parser.add_argument("--seed", type=int, default=43)
    parser.add_argument("--kind", help="this kind alone")
    parser.add_argument("--keep", type=Path, help="where failing files are written")
    options = parser.parse_args()
    found: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        chosen = {kind.name: kind for kind in kinds(Path(name))}
        if options.kind is not None and options.kind not in chosen:
            parser.error(f"--kind: given {options.kind!r}, expected one of {', '.join(chosen)}")
        for kind in chosen.values():
            if options.kind not in (None, kind.name):
                continue
            started = time.monotonic()
            outcomes, failures = fuzz(
                kind,
                count=options.count,
                seed=options.seed,
                folder=Path(name),
                keep=options.keep,
            )
            seconds = time.monotonic() - started
            print(f"{kind.name:14} {dict(outcomes)} {seconds:.0f} s", flush=True)
            found += failures
            print("\n".join(failures[:20]), flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
