"""Mutants of the functions of a module: each is the function with one operator, number or condition changed.

| part of a function | becomes |
|---|---|
| ``<`` ``<=`` ``>`` ``>=`` | the same with or without equality; its negation |
| ``==`` ``in`` ``is`` | its negation |
| ``and`` ``or`` | the other one |
| ``not x``, ``-x`` | ``x`` |
| ``+ - * / // % **``, ``&`` and vertical bar | another one of these |
| a number ``n``; ``True`` | ``n + 1``; ``False`` |
| ``min any sum`` and their like of NumPy | ``max all len`` |
| a condition that is a plain expression | its negation |
| ``break`` | ``continue`` |

Text, annotations, default values of arguments and ``strict=True`` stay as they are.
"""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
from typing import Any, final

__all__ = ["Mutant", "code_of", "function_at", "functions_of", "marked", "mutants_of"]

_COMPARE: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}  # fmt: skip
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
_NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "sum": "len", "minimum": "maximum", "maximum": "minimum"}


@final
@dataclass(frozen=True)
class Mutant:
    """One changed function; ``code`` takes the place of the function's own code object.

    module: its dotted name; function: its qualified name; line: in the file; change: both texts of what was changed.
    """

    module: str
    function: str
    line: int
    change: str
    code: CodeType

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What tells it from other mutants; the line stands last, as it changes with the lines above it."""
        return self.module, self.function, self.change, self.line


def functions_of(module: str) -> list[str]:
    """Qualified names of the functions and methods that a module defines in Python."""
    found = importlib.import_module(module)
    return [name for name, _ in _defined(_tree(found)) if isinstance(_function(found, name), FunctionType)]


def function_at(module: str, name: str) -> FunctionType:
    """The function of that qualified name."""
    found = _function(importlib.import_module(module), name)
    if not isinstance(found, FunctionType):
        raise ValueError(f"{module} defines no function {name}")
    return found


def mutants_of(module: str, name: str) -> Iterator[Mutant]:
    """All mutants of a function."""
    found = importlib.import_module(module)
    count = len(_mutable(dict(_defined(_tree(found)))[name]))
    for i in range(count):
        for k in range(len(_variants(_mutable(dict(_defined(_tree(found)))[name])[i]))):
            tree = _tree(found)
            node = _mutable(dict(_defined(tree))[name])[i]
            new = _variants(node)[k]
            change = f"{_text(node)} -> {_text(new)}"
            changed = ast.fix_missing_locations(_Replaced(node, ast.copy_location(new, node)).visit(tree))
            yield Mutant(module, name, getattr(node, "lineno", 0), change, code_of(changed, found, name))


def marked(module: str, name: str, call: str) -> CodeType:
    """The code of a function that evaluates the expression ``call`` first."""
    found = importlib.import_module(module)
    tree = _tree(found)
    dict(_defined(tree))[name].body.insert(0, ast.Expr(ast.parse(call, mode="eval").body))
    return code_of(ast.fix_missing_locations(tree), found, name)


def code_of(tree: ast.Module, module: ModuleType, name: str) -> CodeType:
    """The code object of a function of a syntax tree."""
    waiting = [compile(tree, module.__file__ or "", "exec", dont_inherit=True)]
    while waiting:
        code = waiting.pop()
        if code.co_qualname == name:
            return code
        waiting += [c for c in code.co_consts if isinstance(c, CodeType)]
    raise ValueError(f"{module.__name__} defines no function {name}")


def _tree(module: ModuleType) -> ast.Module:
    return ast.parse(inspect.getsource(module))


def _defined(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Qualified names and nodes of the functions of a module and of its classes, without those inside functions."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield prefix + node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from _defined(node, f"{prefix}{node.name}.")


def _function(module: ModuleType, name: str) -> Any:
    found: Any = module
    for part in name.split("."):
        found = inspect.getattr_static(found, part, None)
    if isinstance(found, property):
        found = found.fget
    if isinstance(found, staticmethod | classmethod):
        found = found.__func__
    return inspect.unwrap(found) if callable(found) else found


def _mutable(function: ast.FunctionDef) -> list[ast.AST]:
    """The nodes of a function that have variants, in the order of the text; decorators and annotations are no part of it."""
    out: list[ast.AST] = []

    def visit(node: ast.AST) -> None:
        if _variants(node):
            out.append(node)
        for child in ast.iter_child_nodes(node):
            strict = isinstance(child, ast.keyword) and child.arg == "strict"  # it guards: no answer depends on it
            if not strict and not isinstance(child, ast.arguments) and child is not getattr(node, "annotation", None):
                visit(child)

    for statement in function.body:
        visit(statement)
    return out


def _variants(node: ast.AST) -> list[ast.AST]:
    """What a node may be changed to."""
    for kind, variants in _VARIANTS.items():
        if isinstance(node, kind):
            return variants(node)
    return []


def _of_compare(node: Any) -> list[ast.AST]:
    return [ast.Compare(node.left, [new()], node.comparators) for new in _COMPARE[type(node.ops[0])] if len(node.ops) == 1]


def _of_both(node: Any) -> list[ast.AST]:
    return [ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)]


def _of_sign(node: Any) -> list[ast.AST]:
    return [node.operand] if isinstance(node.op, ast.Not | ast.USub) else []


def _of_arithmetic(node: Any) -> list[ast.AST]:
    new = _ARITHMETIC.get(type(node.op))
    if new is None:
        return []
    return [
        ast.AugAssign(node.target, new(), node.value)
        if isinstance(node, ast.AugAssign)
        else ast.BinOp(node.left, new(), node.right)
    ]


def _of_constant(node: Any) -> list[ast.AST]:
    if isinstance(node.value, bool):
        return [ast.Constant(not node.value)]
    return [ast.Constant(node.value + 1)] if isinstance(node.value, int | float) else []


def _of_call(node: Any) -> list[ast.AST]:
    match node.func:
        case ast.Name(id=name) if name in _NAMES:
            return [ast.Call(ast.Name(_NAMES[name], ast.Load()), node.args, node.keywords)]
        case ast.Attribute(value=value, attr=name) if name in _NAMES and name != "sum":
            return [ast.Call(ast.Attribute(value, _NAMES[name], ast.Load()), node.args, node.keywords)]
    return []


def _of_condition(node: Any) -> list[ast.AST]:
    if not _plain(node.test):
        return []
    kind = ast.If if isinstance(node, ast.If) else ast.IfExp
    return [kind(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse)]


def _of_filter(node: Any) -> list[ast.AST]:
    if len(node.ifs) != 1 or not _plain(node.ifs[0]):
        return []
    return [ast.comprehension(node.target, node.iter, [ast.UnaryOp(ast.Not(), node.ifs[0])], node.is_async)]


_VARIANTS: dict[type[ast.AST] | tuple[type[ast.AST], ...], Callable[[Any], list[ast.AST]]] = {
    ast.Compare: _of_compare,
    ast.BoolOp: _of_both,
    ast.UnaryOp: _of_sign,
    (ast.BinOp, ast.AugAssign): _of_arithmetic,
    ast.Constant: _of_constant,
    ast.Call: _of_call,
    (ast.If, ast.IfExp): _of_condition,
    ast.comprehension: _of_filter,
    ast.Break: lambda _: [ast.Continue()],
}


def _plain(test: ast.expr) -> bool:
    """Whether a condition has no operator of its own that is mutated."""
    return not isinstance(test, ast.Compare | ast.BoolOp) and not (isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not))


def _text(node: ast.AST) -> str:
    """The first line of a node's source, shortened."""
    if isinstance(node, ast.If):
        return f"if {ast.unparse(node.test)}"
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 90 else f"{text[:87]}..."


@final
class _Replaced(ast.NodeTransformer):
    """A tree with one node for another."""

    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> Any:
        if node is self.old:
            return self.new
        return self.generic_visit(node)
