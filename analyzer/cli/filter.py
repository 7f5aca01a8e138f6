"""Filters: an expression over a message's fields, safe to run on untrusted text.

    address == 1 and command == "read_speed" and speed > 300
    "bad_checksum" in findings or latency > 0.1
    role == "reply" and status != 1

The text is parsed as a Python expression and walked here; only what stands in the tables below is understood, nothing is
ever evaluated by Python. A name that a message does not have makes its comparison false (and `!=` too): a filter on
`speed` shows only messages with a speed.
"""

from __future__ import annotations

import ast
import difflib
import operator
from collections.abc import Callable, Mapping
from typing import Any

from analyzer.errors import UsageError

#: Names every message has, besides its fields.
NAMES = (
    "address", "bus", "command", "dialect", "role", "time", "latency", "checksum_ok", "findings", "raw", "offset",
    "section", "sequence",
)  # fmt: skip

_LONGEST = 2000
_DEEPEST = 50
_MISSING = object()
_Value = Callable[[Mapping[str, Any]], Any]


def _contains(item: Any, container: Any) -> bool:
    return item in container


_COMPARE: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: _contains,
    ast.NotIn: lambda item, container: item not in container,
}
_ARITHMETIC: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Mod: operator.mod,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
}


class Filter:
    """A compiled filter. Call it with the names of a message; it returns whether the message is wanted.

    Raises UsageError for a text that is not such an expression, with the place.
    """

    def __init__(self, text: str, known: frozenset[str] = frozenset()) -> None:
        if len(text) > _LONGEST:
            raise UsageError(f"filter of {len(text)} characters, expected at most {_LONGEST}")
        try:
            tree = ast.parse(text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            place = f" at character {error.offset}" if isinstance(error, SyntaxError) and error.offset else ""
            raise UsageError(f"filter {text!r}{place}: expected an expression such as 'address == 1'") from None
        self.text = text
        self._known = known
        self._test = self._compile(tree.body, 0)

    def __call__(self, names: Mapping[str, Any]) -> bool:
        """Say whether a message with these names is wanted."""
        try:
            result = self._test(names)
        except (TypeError, ValueError, ArithmeticError):
            return False  # a comparison of things that do not compare, such as a text with a number
        return result is not _MISSING and bool(result)

    def _compile(self, node: ast.AST, depth: int) -> _Value:
        if depth > _DEEPEST:
            raise UsageError(f"filter: nested deeper than {_DEEPEST}")
        deeper = depth + 1
        if isinstance(node, ast.BoolOp):
            parts = [self._compile(v, deeper) for v in node.values]
            every = isinstance(node.op, ast.And)
            return lambda names: all(_true(p(names)) for p in parts) if every else any(_true(p(names)) for p in parts)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            inner = self._compile(node.operand, deeper)
            return lambda names: not _true(inner(names))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            inner = self._compile(node.operand, deeper)
            return lambda names: -inner(names)
        if isinstance(node, ast.Compare):
            return self._comparison(node, deeper)
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            left, right = self._compile(node.left, deeper), self._compile(node.right, deeper)
            combine = _ARITHMETIC[type(node.op)]
            return lambda names: combine(_number(left(names)), _number(right(names)))
        if isinstance(node, ast.Name):
            return self._name(node.id)
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float, str, bool)):
            value = node.value
            return lambda names: value
        if isinstance(node, (ast.List, ast.Tuple, ast.Set)):
            items = [self._compile(e, deeper) for e in node.elts]
            return lambda names: [i(names) for i in items]
        raise UsageError(f"filter: {ast.unparse(node)[:60]!r} is not understood; expected comparisons joined by and, or, not")

    def _comparison(self, node: ast.Compare, depth: int) -> _Value:
        operands = [self._compile(n, depth) for n in (node.left, *node.comparators)]
        operators = []
        for op in node.ops:
            if type(op) not in _COMPARE:
                raise UsageError(f"filter: {type(op).__name__} is not understood; expected == != < <= > >= in")
            operators.append(_COMPARE[type(op)])

        def test(names: Mapping[str, Any]) -> bool:
            values = [o(names) for o in operands]
            if any(v is _MISSING for v in values):
                return False
            return all(compare(a, b) for compare, a, b in zip(operators, values, values[1:], strict=False))

        return test

    def _name(self, name: str) -> _Value:
        if self._known and name not in self._known and name not in NAMES:
            near = difflib.get_close_matches(name, [*NAMES, *self._known], 1, 0.6)
            hint = f"; did you mean {near[0]}?" if near else f" (always there: {', '.join(NAMES)})"
            raise UsageError(f"filter: no field {name!r} in any command{hint}")
        return lambda names: names.get(name, _MISSING)


def _true(value: Any) -> bool:
    return value is not _MISSING and bool(value)


def _number(value: Any) -> Any:
    """Return a number; texts and lists do not calculate, so that no expression can grow without bound."""
    if isinstance(value, (int, float)):
        return value
    raise TypeError("not a number")
