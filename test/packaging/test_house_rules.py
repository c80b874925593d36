# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rules of the code that ruff does not have: short argument lists, no circles, one reader."""

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


def test_no_two_modules_define_a_class_of_the_same_name() -> None:
    trees = TREES.values()
    classes = [{n.name for n in ast.walk(t) if isinstance(n, ast.ClassDef)} for t in trees]
    names = [name for found in classes for name in found]
    assert sorted(name for name in set(names) if names.count(name) > 1) == []


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


def dotted(node: ast.expr) -> str:
    """Return a name, or a name in a module; of anything else nothing."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""
