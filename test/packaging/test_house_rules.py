"""Rules of the code that ruff does not have: short argument lists, named values, no circles."""

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

RECORDS = "quad_mpc_ros.configuration.records"

# Where a matrix is nine numbers, row by row.
OF_NINE = ("control/lie/kernels.py", "control/lie/formulas.py")
LARGEST_INDEX = 2


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


def test_no_buffer_is_indexed_by_number() -> None:
    found = [
        f"{name}:{each}" for name, tree in TREES.items() for each in numbered_indices(name, tree)
    ]
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


OFFENCES = [
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
    ("mpc.py", "re.compile('x').fullmatch(text)[3]"),  # no compiled function, no record
    ("mpc.py", "f = compiled(g)\nx[2, :, -1]\nx[THROTTLE]\ny: Annotated[Array, (3, 3)]"),
    ("control/lie/kernels.py", "f = compiled(g)\na[8]"),
]


def test_every_numbered_index_is_found_and_nothing_that_is_allowed() -> None:
    for code, expected in OFFENCES:
        found = list(numbered_indices("control/ocp/manifold.py", ast.parse(code)))
        assert any(expected in each for each in found), (code, found)
    for name, code in ALLOWED:
        assert not list(numbered_indices(name, ast.parse(code))), code


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
    assert {*OF_NINE} <= TREES.keys()
