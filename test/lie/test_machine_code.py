"""Machine code from disk: the numbers of Numba, without Numba, and never for other types."""

from __future__ import annotations

import dataclasses
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

import quad_mpc_ros
from quad_mpc_ros import compilation, machine_code
from quad_mpc_ros.lie import kernels

ROOT = Path(quad_mpc_ros.__file__).parents[1]

pytestmark = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="elsewhere Numba does it all"
)

MODULE = """
from typing import NamedTuple
import numpy as np
from quad_mpc_ros.compilation import compiled

class Pair(NamedTuple):
    one: float
    other: np.ndarray

@compiled
def scaled(pair, by):
    return Pair(by * pair.one, by * pair.other)

@compiled
def total(values):
    sum = 0.0
    for value in values.ravel():
        sum += value
    return sum

@compiled
def divided(one, other):
    if other == 0:
        raise ValueError("nothing is divided by nothing")
    return one / other

@compiled
def first(count):
    return np.arange(count), count > 3
"""


def run(folder: Path, script: str, **environment: str) -> str:
    """Return what a script prints in a process of its own, beside the module ``numbers_``."""
    (folder / "numbers_.py").write_text(MODULE)
    ended = subprocess.run(
        [
            sys.executable,
            "-c",
            f"import sys\nimport numpy as np\nfrom numbers_ import *\n{script}",
        ],
        env={**os.environ, "PYTHONPATH": f"{folder}:{ROOT}", **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


ASK = """
print(scaled(Pair(1.5, np.arange(3.0)), 2.0))
print(total(np.ones((2, 3))), divided(3.0, 2.0), divided(3.0, 4.0), *first(4), *first(2))
print(scaled(by=3.0, pair=Pair(1.0, np.zeros(1))))
"""


def test_what_was_compiled_once_is_called_without_numba(tmp_path: Path) -> None:
    before = run(tmp_path, ASK)
    asserted = "\nassert not any(name.startswith('numba') for name in sys.modules)"
    assert run(tmp_path, ASK + asserted) == before
    assert before.splitlines()[1] == "6.0 1.5 0.75 [0 1 2 3] True [0 1] False"


def test_other_types_are_never_taken_for_those_that_are_kept(tmp_path: Path) -> None:
    run(tmp_path, "print(total(np.ones((2, 3))))")
    told = run(
        tmp_path,
        """
a = np.arange(12.0).reshape(3, 4)
sealed = a.copy()
sealed.setflags(write=False)
for values in (
    a[:, ::2], a.T, a.astype(np.int64), a.astype(np.float32), a.astype('>f8').astype('<f8'),
    sealed, a.ravel(), a[:, :, None], a[:0], np.asfortranarray(a),
):
    assert total(values) == float(values.sum()), values
print(total.compiled_types)
""",
    )
    for other in ("int64, 2, 'C'", "float32, 2", "2, 'A'", "2, 'C', True"):
        assert other in told


def test_an_error_in_machine_code_is_raised(tmp_path: Path) -> None:
    for _ in range(2):  # compiled, and kept
        told = run(
            tmp_path,
            """
try:
    divided(1.0, 0.0)
except ValueError as error:
    print(error)
try:
    total("text")
except Exception as error:
    print(type(error).__name__)
print(divided(1.0, 4.0))
""",
        )
        assert told.split("\n")[0] == "nothing is divided by nothing"
        assert told.split()[-1] == "0.25"


def test_nothing_leaks(tmp_path: Path) -> None:
    script = """
values, pair = np.ones(3), Pair(1.0, np.ones(3))
def count():
    return [sys.getrefcount(each) for each in (values, pair, pair.other, Pair, None, True)]
def memory():
    return int(open('/proc/self/statm').read().split()[1])
for part in range(4):
    if part == 1:
        before, held = count(), memory()
    for _ in range(20000):
        total(values), scaled(pair, 2.0), first(30)
print(max(abs(a - b) for a, b in zip(count(), before)), memory() - held, 'numba' in sys.modules)
"""
    run(tmp_path, script)
    references, pages, by_numba = run(tmp_path, script).split()
    assert by_numba == "False"
    assert int(references) < 100 and int(pages) < 200


def test_of_another_source_it_is_not_used(tmp_path: Path) -> None:
    assert run(tmp_path, "print(divided(3.0, 2.0))").split() == ["1.5"]
    (tmp_path / "other.py").write_text("# beside it, so the code may contain it\n")
    told = run(tmp_path, "print(divided(3.0, 2.0), 'numba' in sys.modules)")
    assert told.split() == ["1.5", "True"]


@pytest.mark.parametrize("spoilt", [b"", b"\x80", b"nonsense"])
def test_a_file_that_is_spoilt_is_compiled_anew(tmp_path: Path, spoilt: bytes) -> None:
    run(tmp_path, "divided(3.0, 2.0)")
    (kept,) = (tmp_path / "__pycache__").glob("*.code")
    whole = kept.read_bytes()
    for data in (spoilt, whole[:32] + spoilt, whole[: len(whole) // 2]):
        kept.write_bytes(data)
        assert run(tmp_path, "print(divided(3.0, 2.0))").split() == ["1.5"]
        assert kept.read_bytes() == whole


def test_an_object_file_that_is_not_understood_is_refused() -> None:
    kernels.clamp(1.0, 0.0, 2.0)  # compiled, should it not be kept
    code = next(compilation.kept_code(kernels.clamp))
    data = code.object_file
    assert machine_code.loaded(code)(3.0, 0.0, 2.0) == 2.0
    for place, value in ((18, 183), (0, 0), (4, 1)):  # machine; not ELF; 32 bits
        broken = bytearray(data)
        broken[place] = value
        with pytest.raises(machine_code.UnfitError):
            machine_code.loaded(dataclasses.replace(code, object_file=bytes(broken)))
    renamed = data.replace(b"PyErr_SetString", b"PyErr_SetStrong")
    assert renamed != data
    with pytest.raises(machine_code.UnfitError, match="PyErr_SetStrong"):
        machine_code.loaded(dataclasses.replace(code, object_file=renamed))


FLIGHT = """
from quad_mpc_ros import compilation
import os
if os.environ.get("ALL_BY_NUMBA"):
    compilation.kept_code = lambda function: iter(())
from quad_mpc_ros.evaluation.simulated import load_config
from quad_mpc_ros.simulation.closed_loop import fly
mpc, simulator, reference = load_config(
    "default", assignments=("mpc.lockstep=true", "simulator.duration=3.0",
    "simulator.gust_intensity=1.0", "simulator.position_noise=0.01"))
for step in fly(mpc=mpc, simulator=simulator, reference=reference):
    print(step.command.throttle.hex(), step.command.w_WB_B.tobytes().hex())
"""


def test_a_flight_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    by_numba = run(tmp_path, FLIGHT, ALL_BY_NUMBA="1")
    kept = run(tmp_path, FLIGHT)
    without = run(tmp_path, FLIGHT + "\nassert 'numba' not in sys.modules")
    assert by_numba == kept == without
    assert len(kept.splitlines()) == 150


def test_arrays_of_two_types_are_told_apart(tmp_path: Path) -> None:
    """By machine code itself, or before it is called; numbers of eight bytes look alike."""
    (tmp_path / "picked.py").write_text(
        "from quad_mpc_ros.compilation import compiled\n"
        "@compiled\n"
        "def picked(values, places):\n"
        "    return values[places[0]] + values[places[1]]\n"
    )
    first = """
from picked import picked
values, places = np.arange(5.0), np.array([1, 3])
assert picked(values, places) == 4.0
"""
    run(tmp_path, first)
    run(
        tmp_path,
        first
        + """
assert picked.compiled_types == [], "it is kept"
for other in (values.astype(np.int64), values.astype(np.float32), values[:, None][:, 0]):
    assert picked(other, places) == 4
for other in (places.astype(np.int32), places.astype(np.uint64), places[::-1], places.copy()):
    assert picked(values, other) == 4.0
for wrong in (places.astype(float), None, 7):
    try:
        picked(values, wrong)
    except Exception as error:
        assert 'numba' in type(error).__module__ or isinstance(error, TypeError), error
    else:
        raise AssertionError(wrong)
""",
    )
