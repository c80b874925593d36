"""Compiling functions by Numba, with machine code that is kept on disk for the next start.

A function's machine code contains what it calls, and the constants that it reads, of other files
too. Numba asks only whether the function's own file has changed; here all files beside it count,
those of the rooms from which compiled code is built, and this one.

What has been compiled once is called without Numba from then on (``machine_code.py``): Numba is
imported when a function is called with arguments of types for which there is no machine code yet.

This is the one file that uses what Numba keeps to itself: a dispatcher's cache, its object files.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import inspect
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

from quad_mpc_ros import machine_code
from quad_mpc_ros.atomic_file import write_atomically
from quad_mpc_ros.machine_code import KeptCode, Kind, UnfitError

_P = ParamSpec("_P")
_T = TypeVar("_T")

# Compiled code takes functions and constants from here and from its own folder: a test looks.
ROOMS = ("lie", "model", "ocp", "estimation")

# The mark that all is compiled.
_COMPLETE = f"quad_mpc_compile.{sys.implementation.cache_tag}"

_NAMED = {
    "ndarray": np.ndarray,
    "float64": np.float64,
    "int64": np.int64,
    "bool_": np.bool_,
    "dtype_float64": np.dtype(np.float64),
    "dtype_int64": np.dtype(np.int64),
    "dtype_bool": np.dtype(np.bool_),
}


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function when it is first called, and keep the machine code on disk.

    Floating point is strict: a flight is the same, bit for bit, in every process of a machine.
    """
    # A type for each, whose call is its own: no detour by a general one.
    kind = type(function.__name__, (CompiledFunction,), {"__call__": _first_call})
    return cast(Callable[_P, _T], kind(function))


class CompiledFunction:
    """A function that is called as machine code: kept code, or Numba's where there is none."""

    __call__: Callable[..., Any]

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self.source = Path(function.__code__.co_filename).resolve()
        self.settled = False
        """Whether it was called: then the machine code that is kept of it is in memory."""
        self._scope: dict[str, Any] = {}

    @functools.cached_property
    def dispatcher(self) -> Any:
        """What Numba makes of the function."""
        numba = _numba()
        try:
            result = numba.njit(cache=True, error_model="numpy")(self.function)
            _know_all_sources(result)
            _share(result, self)
        except RuntimeError:  # neither beside the source nor in the user's folder may it write
            result = numba.njit(error_model="numpy")(self.function)
        return result

    @property
    def _numba_type_(self) -> Any:
        """What compiled code that calls the function is to take it for."""
        return _numba().types.Dispatcher(self.dispatcher)

    @property
    def compiled_types(self) -> list[str]:
        """The types of arguments for which Numba has compiled it in this process, or looked."""
        known = self.__dict__.get("dispatcher")
        return [] if known is None else [str(signature) for signature in known.signatures]

    @functools.cached_property
    def label(self) -> str:
        """The function's name in the names of files."""
        return f"{self.source.stem}.{self.function.__qualname__}"

    @property
    def digest(self) -> str:
        """A digest of all that makes the machine code what it is."""
        digest = hashlib.blake2b(digest_size=16)
        for part in (*_maker(), _digest(self.source.parent), *_digests_of_all()):
            digest.update(part.encode() + b"\0")
        return digest.hexdigest()

    def by_numba(self, *arguments: Any, **named: Any) -> Any:
        """Call the function as Numba has it, compiled now unless its own cache has it."""
        _left_to_numba.add(self.label)
        self._scope["numba_s"] = self.dispatcher  # without this detour from now on
        return self.dispatcher(*arguments, **named)

    def __reduce__(self) -> str:
        return self.function.__qualname__

    def settle(self) -> None:
        """Take the machine code that is kept, and Numba for all other types."""
        call, self._scope = _call_of(self)
        type.__setattr__(type(self), "__call__", call)
        self.settled = True


_left_to_numba: set[str] = set()


def left_to_numba() -> frozenset[str]:
    """Return the functions that were called with types for which no machine code was kept."""
    return frozenset(_left_to_numba)


def is_complete() -> bool:
    """Return whether :func:`note_complete` was called with everything as it is now."""
    for folder in _folders(Path(__file__).resolve()):
        with contextlib.suppress(OSError):
            if (folder / _COMPLETE).read_text(encoding="utf-8") == _digest_of_everything():
                return True
    return False


def note_complete() -> None:
    """Note that nothing of the package is left to compile."""
    for folder in _folders(Path(__file__).resolve()):
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            write_atomically(folder / _COMPLETE, _digest_of_everything())
            return


def _digest_of_everything() -> str:
    package = Path(__file__).resolve().parent
    folders = sorted({path.parent for path in package.rglob("*.py")})
    parts = (*_maker(), *map(_digest, folders))
    return hashlib.blake2b("\0".join(parts).encode(), digest_size=16).hexdigest()


def _first_call(self: CompiledFunction, *arguments: Any, **named: Any) -> Any:
    self.settle()
    return self(*arguments, **named)


def _call_of(function: CompiledFunction) -> tuple[Callable[..., Any], dict[str, Any]]:
    """Return the method that calls a function: for all types of arguments that are kept, theirs.

    And the names that it knows. It is written out, as there is nothing quicker in Python.
    """
    signature = inspect.signature(function.function)
    names = [*signature.parameters]
    scope: dict[str, Any] = {**_NAMED, "numba_s": function.by_numba}
    lines = [f"def __call__(self, {', '.join(names)}):"]
    given = ", ".join(names)
    kept = [*kept_code(function)]
    for number, code in enumerate(kept):
        # Where there is a choice, who calls has to know before.
        alone = len(kept) == 1 and machine_code.looks_itself(code.kinds)
        try:
            condition, types = machine_code.checks(code.kinds, names, whole=not alone)
            scope[f"kept_{number}"] = machine_code.loaded(code)
        except (UnfitError, ArithmeticError, AttributeError, KeyError, ValueError):
            continue  # Numba will do
        aliases = {name: f"{name}_of_{number}" for name in types}
        for name, alias in aliases.items():
            condition = condition.replace(f" is {name} ", f" is {alias} ")
            scope[alias] = types[name]
        call = f"return kept_{number}({given})"
        trial = ["try:", f"    {call}", "except TypeError:", "    pass"] if alone else [call]
        lines += [f"    if {condition}:", *(f"        {line}" for line in trial)]
    lines.append(f"    return numba_s({given})")
    exec("\n".join(lines), scope)
    return scope["__call__"], scope


@functools.cache
def _numba() -> Any:
    import numba

    return numba


def _know_all_sources(dispatcher: Any) -> None:
    """Let machine code on disk be good only for the sources that it was made of."""
    folder = Path(dispatcher.py_func.__code__.co_filename).resolve().parent
    index = dispatcher._cache._cache_file
    index._source_stamp = _digest(folder), *_digests_of_all()


@functools.cache
def _digests_of_all() -> tuple[str, ...]:
    """Return the digests of what goes into every function's machine code, or how it is made."""
    here = Path(__file__).resolve()
    own = hashlib.blake2b(here.read_bytes(), digest_size=16).hexdigest()
    return own, *(_digest(here.parent / room) for room in ROOMS)


@functools.cache
def _digest(folder: Path) -> str:
    """Return a digest of the Python files of a folder."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


@functools.cache
def _maker() -> tuple[str, ...]:
    """Return who made the machine code, with what settings, and for which processor."""
    versions = (importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy"))
    settings = (f"{name}={value}" for name, value in os.environ.items() if name[:6] == "NUMBA_")
    return sys.version, *versions, *sorted(settings), _processor()


def _processor() -> str:
    """Return what the processor is and can do."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    told = ("model name", "flags", "Features", "CPU implementer", "CPU part")
    return "\n".join(sorted({line for line in text.splitlines() if line.startswith(told)}))


def _share(dispatcher: Any, function: CompiledFunction) -> None:
    """Keep what Numba compiles, or takes from its own cache, in a way that does without Numba.

    And let a function compile anew where Numba's cache cannot be read: that of an earlier version
    may name a type which there is no more, and Numba asks whether it is of an earlier version only
    after reading it.
    """
    cache = dispatcher._cache
    load, reduce, rebuild = cache.load_overload, cache._impl.reduce, cache._impl.rebuild

    def load_overload(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except (AttributeError, ImportError):
            cache.flush()
            return None

    def reduce_and_keep(result: Any) -> Any:
        parts = reduce(result)
        _keep(function, parts)
        return parts

    def rebuild_and_keep(context: Any, parts: Any) -> Any:
        _keep(function, parts)
        return rebuild(context, parts)

    cache.load_overload = load_overload
    cache._impl.reduce, cache._impl.rebuild = reduce_and_keep, rebuild_and_keep


def _keep(function: CompiledFunction, parts: Any) -> None:
    """Write what Numba has compiled to disk, unless it is there, or cannot do without Numba."""
    try:
        code = _code_of(*parts)
    except UnfitError:
        return
    signature = hashlib.blake2b(repr(code.kinds).encode(), digest_size=8).hexdigest()
    name = f"{function.label}.{sys.implementation.cache_tag}.{signature}.code"
    with contextlib.suppress(pickle.PicklingError, TypeError, AttributeError):
        data = function.digest.encode() + pickle.dumps(code)
        for folder in _folders(function.source):
            path = folder / name
            with contextlib.suppress(OSError):
                if not path.exists() or path.read_bytes() != data:
                    folder.mkdir(parents=True, exist_ok=True)
                    draft = path.with_name(f".{name}.{os.getpid()}")
                    draft.write_bytes(data)
                    draft.replace(path)
                return


def kept_code(function: CompiledFunction) -> Iterator[KeptCode]:
    """Yield what is kept of a function, unless Numba is not to compile at all."""
    if "NUMBA_DISABLE_JIT" in os.environ:
        return
    start = f"{function.label}.{sys.implementation.cache_tag}."
    expected = function.digest.encode()
    for folder in _folders(function.source):
        for name in _files(folder):
            if name.startswith(start):
                # Whatever is wrong with it, Numba makes another.
                with contextlib.suppress(Exception):
                    data = (folder / name).read_bytes()
                    if data.startswith(expected):
                        yield pickle.loads(data[len(expected) :])


@functools.cache
def _files(folder: Path) -> tuple[str, ...]:
    """Return the files of kept code in a folder."""
    try:
        return tuple(sorted(path.name for path in folder.glob("*.code")))
    except OSError:
        return ()


def _folders(source: Path) -> tuple[Path, ...]:
    """Return where code of a source may be kept: beside it, and in the user's cache."""
    apart = hashlib.blake2b(str(source.parent).encode(), digest_size=8).hexdigest()
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return (Path(given, "quad_mpc_ros", apart),)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return source.parent / "__pycache__", cache / "quad_mpc_ros" / apart


def _code_of(*parts: Any) -> KeptCode:
    """Return what Numba keeps of a compiled function as it is kept here."""
    library, described, own, signature, as_objects, lifted, _, repeated, referred = parts
    _, form, files = library
    if form != "object" or as_objects or lifted or repeated:
        raise UnfitError("it needs Numba at work")
    environments = {own.env_name: own, **{each.env_name: each for each in referred}}
    return KeptCode(
        kinds=tuple(map(_kind, signature.args)),
        module=described.modname,
        name=described.qualname.rpartition(".")[2],
        wrapper=described.llvm_cpython_wrapper_name,
        object_file=files[0],
        environment=own.env_name,
        environments={name: tuple(each.consts) for name, each in environments.items()},
    )


def _kind(numba_type: Any) -> Kind:
    """Return a type of Numba by plain names."""
    types = _numba().types
    if numba_type in (types.float64, types.int64, types.none):
        return (str(numba_type),)
    if numba_type == types.boolean:
        return ("bool",)
    if type(numba_type) is types.Array and numba_type.layout in "CA":
        if not (numba_type.mutable and numba_type.aligned):
            raise UnfitError("an array that must not be written to")
        dtype = "bool" if numba_type.dtype == types.boolean else str(numba_type.dtype)
        if f"dtype_{dtype}" not in _NAMED:
            raise UnfitError(f"an array of {dtype}")
        return ("array", dtype, numba_type.ndim, numba_type.layout)
    if isinstance(numba_type, types.NamedTuple | types.NamedUniTuple):
        named = numba_type.instance_class
        return ("named", named.__module__, named.__qualname__, tuple(map(_kind, numba_type)))
    if isinstance(numba_type, types.Tuple | types.UniTuple):
        return ("tuple", tuple(map(_kind, numba_type)))
    raise UnfitError(f"an argument of type {numba_type}")
