"""The rules of the code: short argument lists, named values, other libraries by their face."""

from __future__ import annotations

import ast
from collections.abc import Container, Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "quad_mpc_ros"
TREES = {
    str(path.relative_to(PACKAGE)): ast.parse(path.read_text())
    for path in sorted(PACKAGE.rglob("*.py"))
}

MOST_PARAMETERS = 10
MOST_PARAMETERS_OF = {"control/ocp/": 8}
MOST_ALIKE = 5

# The files that may import ctypes, and for which call of the system that Python does not offer.
CTYPES = {
    "ros/realtime.py": "mlockall of libc",
    "commands/processes.py": "prctl of libc, so that no process outlives its parent",
}

# Exported by rclpy, though its package is called experimental.
EXPORTED = {"rclpy.experimental.EventsExecutor"}

CODE_OF_TEXT = {"exec", "eval", "builtins.exec", "builtins.eval"}
OWN = ("quad_mpc_ros", "__future__")
PRIVATE_ROOMS = ("impl", "experimental")
RECORDS = "quad_mpc_ros.configuration.records"
SERIALISERS = {"pickle", "marshal", "shelve", "dill", "cloudpickle"}

# Where a matrix is nine numbers, row by row.
OF_NINE = ("control/lie/kernels.py", "control/lie/formulas.py")
LARGEST_INDEX = 2

# Public whatever their names say.
OF_NAMED_TUPLES = {"_asdict", "_replace", "_fields", "_make"}


def test_no_function_has_more_parameters_than_its_package_may_have() -> None:
    long = [
        f"{name}:{node.lineno}: {node.name} has {count}"
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (count := parameters(node)) > most_parameters(name)
    ]
    assert not long


def most_parameters(file: str) -> int:
    of_packages = [most for package, most in MOST_PARAMETERS_OF.items() if package in file]
    return min([*of_packages, MOST_PARAMETERS])


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    arguments = function.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return len([one for one in every if one.arg not in ("self", "cls")])


def test_no_tuple_type_has_more_than_five_of_a_kind() -> None:
    """But in ``lie``, where a matrix is nine numbers, row by row."""
    alike = [
        f"{name}:{node.lineno}: {ast.unparse(node)}"
        for name, tree in TREES.items()
        if not name.startswith("control/lie/")
        for node in ast.walk(tree)
        if isinstance(node, ast.Subscript)
        and ast.unparse(node.value) == "tuple"
        and isinstance(node.slice, ast.Tuple)
        and most_alike(node.slice) > MOST_ALIKE
    ]
    assert not alike


def most_alike(kinds: ast.Tuple) -> int:
    names = [ast.unparse(kind) for kind in kinds.elts]
    return max(map(names.count, names), default=0)


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Not even inside of functions; what is only for types does not count."""
    modules = {
        ".".join(("quad_mpc_ros", *Path(name).with_suffix("").parts)).removesuffix(
            ".__init__"
        ): tree
        for name, tree in TREES.items()
    }
    imported = {
        name: {*imports(tree, modules)} & modules.keys() - {name} for name, tree in modules.items()
    }

    def reached(module: str) -> set[str]:
        found: set[str] = set()
        waiting = [*imported[module]]
        while waiting:
            if (name := waiting.pop()) not in found:
                found.add(name)
                waiting += imported[name]
        return found

    assert [name for name in modules if name in reached(name)] == []


def imports(tree: ast.AST, modules: Container[str]) -> Iterator[str]:
    """Yield what a module may import when it runs."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.ImportFrom):
            for each in node.names:
                inside = f"{node.module}.{each.name}"
                yield inside if inside in modules else str(node.module)
        elif isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        else:
            yield from imports(node, modules)


def test_no_file_breaks_a_rule() -> None:
    found = [f"{name}:{each}" for name, tree in TREES.items() for each in offences(name, tree)]
    assert not found


READERS = {
    "configuration/ros_yaml.py": {"yaml.load"},
    "configuration/text_files.py": {"csv.reader"},
}


def test_one_function_reads_every_yaml_file_and_one_every_table() -> None:
    readers = {"yaml.load", "yaml.safe_load", "csv.reader", "csv.DictReader", "np.loadtxt"}
    readers.add("np.genfromtxt")
    found: dict[str, set[str]] = {}
    for name, tree in TREES.items():
        calls = {dotted(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        if calls & readers:
            found[name] = calls & readers
    assert found == READERS


def is_self(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id in ("self", "cls")


def defined(tree: ast.Module) -> Iterator[str]:
    """Yield the names that a file's functions, classes and assignments define."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and is_self(node.value)
        ):
            yield node.attr


OWN_PRIVATE = frozenset(name for tree in TREES.values() for name in defined(tree))


OFFENCES = [
    ("node._parameter_overrides", "private attribute _parameter_overrides"),
    ("self._state_machine.current_state", "private attribute _state_machine"),
    ("from numba.core import _helperlib", "private module numba.core._helperlib"),
    ("import rclpy.impl.logging_severity", "private module rclpy.impl.logging_severity"),
    ("exec('1')", "calls exec"),
    ("value = builtins.eval(text)", "calls eval"),
    ("import pickle", "imports pickle"),
    ("from marshal import loads", "imports marshal"),
    ("import ctypes", "imports ctypes"),
    ("from ctypes import CDLL", "imports ctypes"),
    ("sys.modules['scipy'] = None", "writes sys.modules"),
    ("del sys.modules['scipy']", "writes sys.modules"),
    ("sys.modules.setdefault('scipy', None)", "writes sys.modules"),
    ("modules = sys.modules", "writes sys.modules"),
    ("from sys import modules", "writes sys.modules"),
    ("@compiled\ndef f(x):\n    return x[14]", "index 14"),
    ("@compiled\ndef f(x):\n    return x[i, 12]", "index 12"),
    ("@compiled\ndef f(x):\n    return x[i, 1 + k]", "offset 1 + k"),
    ("@compiled\ndef f(x):\n    return x[n + 1 + k]", "offset n + 1 + k"),
    ("f = compiled(g)\nx[16:19]", "index 16"),
    ("f = compiled(g)\nx[:9] = 0.0", "index 9"),
    ("f = compiled(g)\nx[-5]", "index 5"),
    ("from quad_mpc_ros.configuration.records import Record\nx[3]", "index 3"),
]
ALLOWED = [
    ("mpc.py", "class A:\n    def f(self):\n        self._x = 1\n        return self._x"),
    ("spin.py", "from rclpy.experimental import EventsExecutor"),
    ("ros/realtime.py", "import ctypes"),
    ("mpc.py", "if 'rclpy' in sys.modules:\n    sys.modules['rclpy'].ok()"),
    ("mpc.py", "re.compile('x').fullmatch(text)[3]"),  # no compiled function, no record
    ("mpc.py", "f = compiled(g)\nx[2, :, -1]\nx[THROTTLE]\ny: Annotated[Array, (3, 3)]"),
    ("control/lie/kernels.py", "f = compiled(g)\na[8]"),
]


def test_every_offence_is_found_and_nothing_that_is_allowed() -> None:
    for code, expected in OFFENCES:
        found = list(offences("control/ocp/manifold.py", ast.parse(code)))
        assert any(expected in each for each in found), (code, found)
    for name, code in ALLOWED:
        assert not list(offences(name, ast.parse(code))), code


def offences(name: str, tree: ast.Module) -> Iterator[str]:
    """Yield what a file does against the rules, each with its line."""
    for rule in (foreign_attributes, foreign_imports, tricks, numbered_indices):
        yield from rule(name, tree)


def foreign_attributes(_name: str, tree: ast.Module) -> Iterator[str]:
    """Of ``self`` what a class of this package defines, of anything else what its file defines."""
    own = set(defined(tree))
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and node.attr.startswith("_")
            and not node.attr.startswith("__")
            and node.attr not in OF_NAMED_TUPLES
            and node.attr not in own
            and not (is_self(node.value) and node.attr in OWN_PRIVATE)
        ):
            yield f"{node.lineno}: private attribute {node.attr} of {ast.unparse(node.value)}"


def foreign_imports(name: str, tree: ast.Module) -> Iterator[str]:
    """Modules with an underscore, rclpy's ``impl``, ctypes, and what makes objects of bytes."""
    for node in ast.walk(tree):
        for module in imported(node):
            parts = module.split(".")
            if parts[0] in SERIALISERS or (parts[0] == "ctypes" and name not in CTYPES):
                yield f"{node.lineno}: imports {parts[0]}"
            if module == "sys.modules":
                yield f"{node.lineno}: writes sys.modules, perhaps"
            private = any(part.startswith("_") or part in PRIVATE_ROOMS for part in parts)
            if private and parts[0] not in OWN and module not in EXPORTED:
                yield f"{node.lineno}: private module {module}"


def tricks(_name: str, tree: ast.Module) -> Iterator[str]:
    """Code made of text, and modules put in the place of others."""
    read = set()
    for node in ast.walk(tree):
        # Only looking one up by name, or asking whether it is there, leaves it as it is.
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load):
            read.add(node.value)
        elif isinstance(node, ast.Compare):
            read.update(node.comparators)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and dotted(node.func) in CODE_OF_TEXT:
            yield f"{node.lineno}: calls {dotted(node.func).removeprefix('builtins.')}"
        if isinstance(node, ast.Attribute) and dotted(node) == "sys.modules" and node not in read:
            yield f"{node.lineno}: writes sys.modules"


def dotted(node: ast.expr) -> str:
    """Return a name, or a name in a module; of anything else nothing."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def numbered_indices(name: str, tree: ast.Module) -> Iterator[str]:
    """Integers above 2 as index or bound, in files that pack numbers: records have names.

    And what is added to a number, `1 + k`: where a part begins has a name. `k + 1` is the next.
    """
    if name in OF_NINE or not packs(tree):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript):
            for number in map(magnitude, bounds(node.slice)):
                if number > LARGEST_INDEX:
                    yield f"{node.lineno}: index {number} in {ast.unparse(node)}"
            yield from map(f"{node.lineno}: {{}}".format, hand_written_offsets(node.slice))


def hand_written_offsets(index: ast.expr) -> Iterator[str]:
    """Yield the sums in an index in which a number comes before what is added."""
    for total in ast.walk(index):
        if (
            isinstance(total, ast.BinOp)
            and isinstance(total.op, ast.Add)
            and magnitude(last_term(total.left)) > 0
        ):
            yield f"offset {ast.unparse(total)}"


def packs(tree: ast.Module) -> bool:
    """Whether a file has compiled functions, or handles records."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any(
            dotted(decorator) == "compiled" for decorator in node.decorator_list
        ):
            return True
        if isinstance(node, ast.Call) and dotted(node.func) == "compiled":
            return True
        if any(module.startswith(RECORDS) for module in imported(node)):
            return True
    return False


def bounds(index: ast.expr) -> Iterator[ast.expr]:
    """Yield the numbers in an index: itself, the ends of a slice, or those of several axes."""
    for axis in index.elts if isinstance(index, ast.Tuple) else [index]:
        if isinstance(axis, ast.Slice):
            yield from (end for end in (axis.lower, axis.upper) if end is not None)
        else:
            yield axis


def last_term(total: ast.expr) -> ast.expr:
    """Return what stands right before a plus: of `n + 1` the 1."""
    is_sum = isinstance(total, ast.BinOp) and isinstance(total.op, ast.Add)
    return total.right if is_sum else total


def magnitude(number: ast.expr) -> int:
    """Return the magnitude of an integer literal, 0 of anything else."""
    if isinstance(number, ast.UnaryOp) and isinstance(number.op, ast.USub):
        number = number.operand
    is_integer = isinstance(number, ast.Constant) and type(number.value) is int
    return number.value if is_integer else 0


def imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def test_every_exception_is_there() -> None:
    assert {*CTYPES, *OF_NINE} <= TREES.keys()
