"""Machine code that Numba has made, taken from disk and called without Numba.

Numba with its compiler takes 100 MB of memory and half a second, in each process, to hand over
what was compiled long ago. What it keeps of a function is an object file (ELF) with a wrapper that
takes Python's arguments. Here such a file is put into memory, its references are resolved, as a
linker would, and the wrapper is called.

References go to Python's C API, to the C library, and to the small extension modules of Numba that
hold its arrays and its errors; those are loaded alone. Whatever is met that is not known here
raises :class:`UnfitError`, and Numba has to do it.
"""

from __future__ import annotations

import builtins
import ctypes
import functools
import importlib.util
import mmap
import pickle
import platform
import struct
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

Kind = tuple[Any, ...]
"""The type of an argument: ``("float64",)``, ``("array", "float64", 2, "C")``, and so on."""

_ENVIRONMENT = "_ZN08NumbaEnv"
_MACHINE = 62  # x86_64
_ALIGNMENT = 64
_LARGEST = 1 << 31

_HEADER = struct.Struct("<16sHHIQQQIHHHHHH")
_SECTION = struct.Struct("<IIQQQQIIQQ")
_SYMBOL = struct.Struct("<IBBHQQ")
_RELOCATION = struct.Struct("<QQq")
_SYMBOLS, _RELOCATIONS, _UNWINDING, _ZEROS = 2, 4, 0x70000001, 8  # types of sections
_WRITTEN, _LOADED = 1, 2  # flags of sections
_UNDEFINED, _ABSOLUTE, _COMMON = 0, 0xFFF1, 0xFFF2  # sections of symbols
_ADDRESS, _DISTANCE, _CALL = 1, 2, 4  # relocations


class UnfitError(Exception):
    """Machine code that cannot be used here; the message says why."""


@dataclass(frozen=True, kw_only=True)
class KeptCode:
    """A function compiled for arguments of certain types, as it lies on disk.

    ``environments`` has the constants that compiled code asks Python for, by the name under which
    it looks for them; ``environment`` is the one of the function itself.
    """

    kinds: tuple[Kind, ...]
    module: str
    name: str
    wrapper: str
    object_file: bytes
    environment: str
    environments: Mapping[str, tuple[Any, ...]]


def loaded(code: KeptCode) -> Callable[..., Any]:
    """Return a function that runs machine code.

    Where :func:`looks_itself` says so it raises ``TypeError`` for arrays of other types and
    layouts. All else has to be checked before (:func:`checks`).
    """
    if platform.machine() != "x86_64" or sys.platform != "linux":
        raise UnfitError("only for Linux on x86_64")
    helpers = _helpers()
    scope = sys.modules[code.module].__dict__
    environments = {}
    for name, constants in code.environments.items():
        environments[name] = helpers.dynfunc.Environment(scope if name == code.environment else {})
        environments[name].consts[:] = map(_as_it_is_here, constants)
    given = {name: id(made) for name, made in environments.items()}
    placed = _Placed(code.object_file, given, resolved=_resolver(code.kinds))
    _forever.append((placed, environments))
    return helpers.dynfunc.make_function(  # type: ignore[no-any-return]
        sys.modules[code.module],
        code.name,
        "",
        placed.address(code.wrapper),
        environments[code.environment],
        (placed, environments),
    )


def _as_it_is_here(constant: Any) -> Any:
    """Return a constant from disk; of each of NumPy's types there is but one that all share."""
    return np.dtype(constant.type) if isinstance(constant, np.dtype) else constant


_forever: list[Any] = []  # machine code may be on a stack at any time


class _Section(NamedTuple):
    name: int
    type: int
    flags: int
    address: int
    offset: int
    size: int
    link: int
    info: int
    alignment: int
    entry_size: int


class _Placed:
    """An object file in memory; ``environments`` are addresses of Python's objects by name.

    ``resolved`` returns the address of what the file refers to.
    """

    def __init__(
        self, data: bytes, environments: Mapping[str, int], *, resolved: Callable[[str], int]
    ) -> None:
        self._data, self._resolved = data, resolved
        header = _HEADER.unpack_from(data)
        if header[0][:5] != b"\x7fELF\x02" or header[2] != _MACHINE:
            raise UnfitError("not an object file of x86_64")
        start, count = header[6], header[12]
        self._sections = [
            _Section(*_SECTION.unpack_from(data, start + i * _SECTION.size)) for i in range(count)
        ]
        self._bases: dict[int, int] = {}
        symbols = self._symbols()
        commons = [place for place, symbol in enumerate(symbols) if symbol[3] == _COMMON]
        self._code = self._put(lambda section: not section.flags & _WRITTEN, 0)
        self._written = self._put(lambda section: bool(section.flags & _WRITTEN), 8 * len(commons))
        self._addresses = [self._address_of(symbol) for symbol in symbols]
        cells = self._written.free
        for cell, place in enumerate(commons):
            name = self._name(symbols[place])
            if not name.startswith(_ENVIRONMENT) or symbols[place][5] != 8:
                raise UnfitError(f"unknown data {name}")
            self._addresses[place] = cells + 8 * cell
            # As Numba has it: what was made while compiling, and is not kept, is never asked for.
            ctypes.c_uint64.from_address(cells + 8 * cell).value = environments.get(name, 0)
        self._by_name = {
            self._name(symbol): address
            for symbol, address in zip(symbols, self._addresses, strict=True)
        }
        self._relocate()
        self._code.make_executable()

    def address(self, name: str) -> int:
        """Return where a symbol is."""
        return self._by_name[name]

    def _symbols(self) -> list[tuple[int, ...]]:
        (table,) = (section for section in self._sections if section.type == _SYMBOLS)
        self._names = self._sections[table.link].offset
        return [
            _SYMBOL.unpack_from(self._data, table.offset + i * _SYMBOL.size)
            for i in range(table.size // _SYMBOL.size)
        ]

    def _name(self, symbol: tuple[int, ...]) -> str:
        start = self._names + symbol[0]
        return self._data[start : self._data.index(b"\0", start)].decode()

    def _put(self, chosen: Callable[[_Section], bool], more: int) -> _Memory:
        """Copy the chosen sections, among those that are to be loaded, into memory."""
        places, size = {}, 0
        for number, section in enumerate(self._sections):
            if section.flags & _LOADED and section.type != _UNWINDING and chosen(section):
                if section.alignment > mmap.PAGESIZE:
                    raise UnfitError(f"a section aligned to {section.alignment}")
                step = max(section.alignment, 1)
                places[number] = size = -(-size // step) * step
                size += section.size
        size = -(-size // _ALIGNMENT) * _ALIGNMENT
        memory = _Memory(size, more)
        for number, place in places.items():
            section = self._sections[number]
            self._bases[number] = memory.address + place
            if section.type != _ZEROS:
                end = section.offset + section.size
                memory.write(place, self._data[section.offset : end])
        return memory

    def _address_of(self, symbol: tuple[int, ...]) -> int:
        section, value = symbol[3], symbol[4]
        if section == _UNDEFINED:
            name = self._name(symbol)
            return self._resolved(name) if name else 0
        if section in (_ABSOLUTE, _COMMON):
            return value
        return self._bases.get(section, 0) + value

    def _relocate(self) -> None:
        for section in self._sections:
            if section.type == _RELOCATIONS and section.info in self._bases:
                base = self._bases[section.info]
                for i in range(section.size // _RELOCATION.size):
                    offset, info, addend = _RELOCATION.unpack_from(
                        self._data, section.offset + i * _RELOCATION.size
                    )
                    target = self._addresses[info >> 32] + addend
                    _write_reference(base + offset, target, kind=info & 0xFFFFFFFF)


def _write_reference(place: int, target: int, *, kind: int) -> None:
    if kind == _ADDRESS:
        ctypes.c_uint64.from_address(place).value = target
    elif kind in (_DISTANCE, _CALL) and abs(target - place) < _LARGEST:
        ctypes.c_int32.from_address(place).value = target - place
    else:
        raise UnfitError(f"a reference of kind {kind}")


class _Memory:
    """Pages of their own: ``size`` bytes at ``address``, more of them from ``free`` on."""

    def __init__(self, size: int, more: int) -> None:
        self._map = mmap.mmap(-1, max(size + more, 1), flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        self._view = ctypes.c_char.from_buffer(self._map)
        self.address = ctypes.addressof(self._view)
        self.free = self.address + size

    def write(self, place: int, data: bytes) -> None:
        """Copy data to a place in it."""
        self._map[place : place + len(data)] = data

    def make_executable(self) -> None:
        """Let it be run, and written no more."""
        libc = ctypes.CDLL(None, use_errno=True)
        size = -(-len(self._map) // mmap.PAGESIZE) * mmap.PAGESIZE
        if libc.mprotect(ctypes.c_void_p(self.address), ctypes.c_size_t(size), 0x1 | 0x4) != 0:
            raise UnfitError(f"the system does not let it be run (errno {ctypes.get_errno()})")


class _Helpers(NamedTuple):
    """What Numba's extension modules have: a factory of functions, and C functions by name."""

    dynfunc: Any
    addresses: Mapping[str, int]


@functools.cache
def _helpers() -> _Helpers:
    spec = importlib.util.find_spec("numba")
    if spec is None or spec.origin is None:
        raise UnfitError("there is no Numba")
    folder = Path(spec.origin).parent
    dynfunc, helpers, runtime = (
        _extension(folder, name) for name in ("_dynfunc", "_helperlib", "core.runtime._nrt_python")
    )
    addresses = dict(helpers.c_helpers)
    for module in (helpers, dynfunc):
        addresses |= {f"numba_{name}": at for name, at in module.c_helpers.items()}
    for name, at in runtime.c_helpers.items():
        addresses[name if name.startswith("_") else f"NRT_{name}"] = at
    addresses["numba_unpickle"] = _address(_unpickler)
    return _Helpers(dynfunc, addresses)


def _extension(folder: Path, name: str) -> Any:
    """Return an extension module of Numba without importing Numba."""
    full = f"numba.{name}"
    if full in sys.modules:
        return sys.modules[full]
    stem = folder.joinpath(*name.split("."))
    for suffix in EXTENSION_SUFFIXES:
        path = stem.with_name(stem.name + suffix)
        if path.exists():
            spec = importlib.util.spec_from_file_location(
                full, path, loader=ExtensionFileLoader(full, str(path))
            )
            if spec is not None and spec.loader is not None:
                module = importlib.util.module_from_spec(spec)
                spec.loader.exec_module(module)
                sys.modules.pop(full, None)  # it is Numba's to import, should it come
                return module
    raise UnfitError(f"this Numba has no {full}")


_TAKE_ARRAY = "NRT_adapt_ndarray_from_python"
# NumPy's numbers of its types, and of what an array is (numpy/ndarraytypes.h).
_TYPE_NUMBERS = {"float64": 12, "int64": 7}
_IN_ORDER = 0x0001 | 0x0100 | 0x0400  # C contiguous, aligned, writeable


def looks_itself(kinds: Iterable[Kind]) -> bool:
    """Return whether machine code sees by itself that an array is not what it takes it for.

    It does where all arrays are contiguous, of floating or of whole numbers of eight bytes. It
    does not see how many dimensions there are, nor, where there are both, which of the two.
    """
    return {array[1:] for array in _arrays(kinds)} <= {
        (dtype, dimensions, "C") for dtype in _TYPE_NUMBERS for dimensions in range(8)
    }


def _arrays(kinds: Iterable[Kind]) -> list[Kind]:
    """Return the arrays among kinds, and within their parts."""
    found = []
    for kind in kinds:
        if kind[0] == "array":
            found.append(kind)
        elif kind[0] in ("tuple", "named"):
            found += _arrays(kind[-1])
    return found


def _resolver(kinds: Iterable[Kind]) -> Callable[[str], int]:
    """Return what resolves the references of machine code for arguments of certain kinds."""
    kinds = tuple(kinds)
    dtypes = frozenset(array[1] for array in _arrays(kinds))
    if not (dtypes and looks_itself(kinds)):
        return _resolved
    careful = _careful(dtypes)
    return lambda name: careful if name == _TAKE_ARRAY else _resolved(name)


@functools.cache
def _careful(dtypes: frozenset[str]) -> int:
    """Return the address of what takes arrays as Numba does, but refuses those of other types.

    Numba's own asks for nothing but the size of a number. In Python, the question for type and
    layout takes longer than all of the call.
    """
    one, *_, other = (_TYPE_NUMBERS[dtype] for dtype in (*dtypes, *dtypes))
    array_type, taken = (value.to_bytes(8, "little") for value in (id(np.ndarray), _taker()))
    order = _IN_ORDER.to_bytes(4, "little")
    code = b"".join(
        (
            b"\x48\xb8" + array_type,  # mov rax, the type of arrays
            b"\x48\x39\x47\x08",  # cmp [rdi + 8], rax: the argument's type
            b"\x75\x33",  # jne refuse
            b"\x8b\x47\x40",  # mov eax, [rdi + 64]: its flags
            b"\x25" + order,  # and eax, those of interest
            b"\x3d" + order,  # cmp eax, all of them
            b"\x75\x24",  # jne refuse
            b"\x48\x8b\x47\x38",  # mov rax, [rdi + 56]: the type of its numbers
            b"\x83\x78\x1c" + bytes([one]),  # cmp dword [rax + 28]: that type's number
            b"\x74\x06",  # je fit
            b"\x83\x78\x1c" + bytes([other]),  # cmp dword [rax + 28]
            b"\x75\x14",  # jne refuse
            b"\x80\x78\x1a\x3e",  # fit: cmp byte [rax + 26], '>': the order of its bytes
            b"\x74\x0e",  # je refuse
            b"\x48\xb8" + taken,  # mov rax, what Numba does then
            b"\xff\xe0",  # jmp rax
            b"\xcc\xcc",
            b"\xb8\xff\xff\xff\xff\xc3",  # refuse: mov eax, -1; ret
        )
    )
    memory = _Memory(len(code), 0)
    memory.write(0, code)
    memory.make_executable()
    _forever.append(memory)
    return memory.address


def _taker() -> int:
    return _resolved(_TAKE_ARRAY)


def _resolved(name: str) -> int:
    """Return the address of a function or a datum of Numba, Python or the C library."""
    if name == "_Py_NoneStruct":
        return id(None)
    if name.startswith("PyExc_"):  # Numba means the class itself
        return id(getattr(builtins, name.removeprefix("PyExc_")))
    found = _helpers().addresses.get(name)
    if found is not None:
        return found
    for library in (ctypes.pythonapi, ctypes.CDLL(None)):
        try:
            return _address(getattr(library, name))
        except AttributeError:
            continue
    raise UnfitError(f"there is no {name}")


def _address(function: Any) -> int:
    return int(ctypes.cast(function, ctypes.c_void_p).value or 0)


_unpickled: dict[int, Any] = {}


def _unpickle(data: int, size: int, _: int) -> Any:
    """Return an object that machine code has the pickle of, as Numba's own function does."""
    if data not in _unpickled:
        _unpickled[data] = pickle.loads(ctypes.string_at(data, size))
    return _unpickled[data]


_unpickler = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(
    _unpickle
)


def checks(
    kinds: Sequence[Kind], names: Iterable[str], *, whole: bool = True
) -> tuple[str, dict[str, type]]:
    """Return an expression that is true for arguments of certain kinds, and what it names.

    Of arrays the ``whole`` type, or what machine code that looks itself does not see.
    """
    scope: dict[str, type] = {}
    several = len({array[1] for array in _arrays(kinds)}) > 1
    parts = []
    for kind, name in zip(kinds, names, strict=True):
        if whole or kind[0] != "array":
            parts.append(_check(kind, name, scope))
        else:
            parts.append(f"type({name}) is ndarray and {name}.ndim == {kind[2]}")
            parts += [_check_numbers(kind, name)] if several else []
    return " and ".join(parts) or "True", scope


def _check(kind: Kind, name: str, scope: dict[str, type]) -> str:
    match kind:
        case ("float64",):
            return f"(type({name}) is float or type({name}) is float64)"
        case ("int64",):
            return f"(type({name}) is int or type({name}) is int64)"
        case ("bool",):
            return f"(type({name}) is bool or type({name}) is bool_)"
        case ("none",):
            return f"{name} is None"
        case ("array", _, dimensions, layout):
            flags = f"{name}.flags"
            strided = f"{flags}.behaved and not {flags}.c_contiguous and not {flags}.f_contiguous"
            return (
                f"type({name}) is ndarray and {name}.ndim == {dimensions} "
                f"and {_check_numbers(kind, name)} "
                f"and {f'{flags}.carray' if layout == 'C' else strided}"
            )
        case ("tuple", parts):
            return _check_parts("tuple", parts, name, scope)
        case ("named", module, qualified_name, parts):
            found: Any = sys.modules[module]
            for step in qualified_name.split("."):
                found = getattr(found, step)
            alias = f"type_{len(scope)}"
            scope[alias] = found
            return _check_parts(alias, parts, name, scope)
    raise UnfitError(f"an argument of kind {kind}")


def _check_numbers(kind: Kind, name: str) -> str:
    return f"({name}.dtype is dtype_{kind[1]} or {name}.dtype == dtype_{kind[1]})"


def _check_parts(of: str, parts: Iterable[Kind], name: str, scope: dict[str, type]) -> str:
    inner = [_check(part, f"{name}[{i}]", scope) for i, part in enumerate(parts)]
    return " and ".join((f"type({name}) is {of}", f"len({name}) == {len(inner)}", *inner))
