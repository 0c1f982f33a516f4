"""Small faults to put into a module: every place where one can go, and the module's source with it."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_COMPARISONS = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_NAMES = {"min": "max", "minimum": "maximum", "any": "all", "sin": "cos", "real": "imag", "floor": "ceil"}
_NAMES |= {other: name for name, other in _NAMES.items()}


@dataclass(frozen=True)
class Mutant:
    """A module with one fault; ``name`` says which, and stays the same when lines above it come or go."""

    name: str
    function: str
    line: int
    tree: ast.Module
    old: ast.AST
    new: ast.AST

    def source(self) -> str:
        """The text of the module with the fault in it."""
        tree = copy.deepcopy(self.tree, memo := {})
        old, new = memo[id(self.old)], self.new

        class Swap(ast.NodeTransformer):
            def visit(self, node: ast.AST) -> ast.AST:
                return new if node is old else self.generic_visit(node)

        return ast.unparse(ast.fix_missing_locations(Swap().visit(tree)))


def mutants_of(file: Path) -> list[Mutant]:
    """All mutants of a module. Left alone are what tests cannot or need not notice: annotations, messages, imports,
    default values, strict zips, and the tuning constants at the head of a module."""
    tree = ast.parse(file.read_text())
    found: dict[str, Mutant] = {}
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in (node for statement in function.body for node in _code(statement)):
            for old, new in _changes(node):
                name = f"{function.name}: {ast.unparse(old)} -> {ast.unparse(new)}".replace("\n", "; ")
                same = sum(known.split(" #")[0] == name for known in found)  # the same words again in one function
                name += f" #{same + 1}" * (same > 0)
                found[name] = Mutant(name, function.name, getattr(old, "lineno", 0), tree, old, new)
    return list(found.values())


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """A node and what is in it, but for what is left alone and functions in it, which have their own turn."""
    if isinstance(node, (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.FunctionDef)):
        return
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return
    yield node
    for field, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and field != "annotation":
                yield from _code(child)


def _changes(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """What of a node is replaced by what."""
    match node:
        case ast.Compare(ops=[operator, *rest]) if type(operator) in _COMPARISONS:
            yield node, ast.Compare(node.left, [_COMPARISONS[type(operator)](), *rest], node.comparators)
        case ast.BinOp(left, operator, right) if type(operator) in _OPERATORS:
            yield node, ast.BinOp(left, _OPERATORS[type(operator)](), right)
        case ast.BoolOp(operator, values):
            yield node, ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
        case ast.UnaryOp(operand=operand):
            yield node, operand
        case ast.Constant(value=bool() as value):
            yield node, ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield node, ast.Constant(value + 1)
        case ast.Constant(value=float() as value):
            yield node, ast.Constant(value * 1.5 if value else 1.0)
        case ast.If(test) | ast.While(test) | ast.IfExp(test):
            yield test, ast.UnaryOp(ast.Not(), test)
        case ast.Attribute(value, attr, context) if attr in _NAMES:
            yield node, ast.Attribute(value, _NAMES[attr], context)
        case ast.Name(name, context) if name in _NAMES:
            yield node, ast.Name(_NAMES[name], context)
        case ast.AugAssign():
            yield node, ast.Pass()
        case ast.Call(func=ast.Attribute(attr="conj" | "conjugate" | "abs" | "sqrt"), args=[first]):
            yield node, first
