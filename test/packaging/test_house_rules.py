"""What the code has promised of itself: short argument lists, named values, no burglary."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "quad_mpc_ros"
TREES = {
    str(path.relative_to(PACKAGE)): ast.parse(path.read_text())
    for path in sorted(PACKAGE.rglob("*.py"))
}

MOST_PARAMETERS = 10
MOST_ALIKE = 5

# The files that touch what a library keeps to itself. Each has a test that fails when a new
# version of the library changes it.
ADAPTERS = {"ros/rclpy_internals.py"}

# Public whatever their names say.
OF_NAMED_TUPLES = {"_asdict", "_replace", "_fields", "_make"}


def test_no_function_has_more_than_ten_parameters() -> None:
    long = [
        f"{name}:{node.lineno}: {node.name} has {count}"
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (count := parameters(node)) > MOST_PARAMETERS
    ]
    assert not long


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


def test_private_attributes_of_others_are_touched_in_adapters_only() -> None:
    """Of ``self`` what a class of this package defines, of anything else what its file defines."""
    everywhere = {name for tree in TREES.values() for name in defined(tree)}
    foreign = [
        f"{name}:{node.lineno}: {ast.unparse(node)}"
        for name, tree in TREES.items()
        if name not in ADAPTERS
        for node in private(tree)
        if node.attr not in (everywhere if is_self(node.value) else set(defined(tree)))
    ]
    assert not foreign


def test_private_modules_of_others_are_imported_in_adapters_only() -> None:
    """Those that begin with an underscore, and rclpy's ``impl`` and ``experimental``."""
    foreign = [
        f"{name}:{node.lineno}: {module}"
        for name, tree in TREES.items()
        if name not in ADAPTERS
        for node in ast.walk(tree)
        for module in imported(node)
        if not module.startswith(("quad_mpc_ros", "__future__"))
        and any(
            part.startswith("_") or part in ("impl", "experimental") for part in module.split(".")
        )
    ]
    assert not foreign


def imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def private(tree: ast.Module) -> Iterator[ast.Attribute]:
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and node.attr.startswith("_")
            and not node.attr.startswith("__")
            and node.attr not in OF_NAMED_TUPLES
        ):
            yield node


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


def test_every_adapter_is_there() -> None:
    assert set(TREES) >= ADAPTERS
