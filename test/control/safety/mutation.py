"""Changing one condition of a module at a time, to see whether its tests notice."""

from __future__ import annotations

import ast
import copy
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import NamedTuple

_OTHER_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}


class Mutant(NamedTuple):
    """A module with one change, described by the line as it is then."""

    description: str
    tree: ast.Module

    def load(self) -> ModuleType:
        """Run the changed module under a name of its own."""
        module = ModuleType("mutant")
        sys.modules["mutant"] = module
        try:
            exec(compile(self.tree, "<mutant>", "exec"), module.__dict__)
        finally:
            del sys.modules["mutant"]
        return module


def mutants(source: str) -> Iterator[Mutant]:
    """Yield the module once for each change of a comparison, a condition, a sum or a branch."""
    original = ast.parse(source)
    for number, node in enumerate(ast.walk(original)):
        for variant in range(len(list(_variants(node)))):
            tree = copy.deepcopy(original)
            changed = list(ast.walk(tree))[number]
            replacement = list(_variants(changed))[variant]
            before = ast.unparse(changed)
            after = ast.unparse(replacement)
            _replace(tree, changed, replacement)
            line = getattr(changed, "lineno", 0)
            yield Mutant(f"line {line}: {before} -> {after}", ast.fix_missing_locations(tree))


def _variants(node: ast.AST) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(ops=[operator]):
            for other in _OTHER_COMPARISONS.get(type(operator), ()):
                changed = copy.copy(node)
                changed.ops = [other()]
                yield changed
        case ast.BoolOp(op=operator, values=values):
            swapped = copy.copy(node)
            swapped.op = ast.Or() if isinstance(operator, ast.And) else ast.And()
            yield swapped
            yield from values
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield operand
        case ast.BinOp(op=ast.Sub()):
            changed_sum = copy.copy(node)
            changed_sum.op = ast.Add()
            yield changed_sum
        case ast.IfExp(body=body, orelse=otherwise):
            yield body
            yield otherwise
        case ast.If():
            for value in (True, False):
                forced = copy.copy(node)
                forced.test = ast.Constant(value)
                yield forced


def _replace(tree: ast.Module, old: ast.AST, new: ast.AST) -> None:
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
            elif isinstance(value, list):
                value[:] = [new if item is old else item for item in value]
