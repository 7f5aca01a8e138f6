"""Filters: an expression over what a message shows, safe to run on untrusted text.

    address == 1 and command == "read_speed" and speed > 300
    "bad_checksum" in findings or latency > 5ms
    role == "reply" and status != "complete"

The text is parsed as a Python expression and walked here; only what stands in the tables below is understood, nothing is
ever evaluated by Python. What can never match is an error: a name that no command has, a number for a text, a value that the
bits cannot hold. A name that one message does not have makes its comparison false (and `!=` too).

A number without a unit is in the unit that the table shows (`speed > 300`: rpm, or deg/s of a drive that counts so; `latency
> 5`: ms). With a unit it is converted. A choice is compared by its name or its number. `findings` holds rules and severities.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any

from analyzer.catalogue import Dialect, Role
from analyzer.errors import UsageError
from analyzer.findings import RULES
from analyzer.layout import NOT_NUMERIC, Field, FieldKind
from analyzer.records import Frame, Severity
from analyzer.values import factor, near, quote, raw_text

_LONGEST = 2000
_DEEPEST = 50
#: What every number of a message is below, by far.
_HIGHEST = 1 << 64
#: One equals sign alone, where a comparison has two.
_ASSIGNED = re.compile(r"(?<![=<>!])=(?!=)")
#: A number and the unit behind it, outside of texts: `5ms`, `1.6 A`, `90°`.
_QUANTITY = re.compile(
    r"""("[^"]*"|'[^']*')|(?<![\w.])((?>0[xXbBoO][0-9a-fA-F]+|(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?))\s*"""
    r"""(?!(?:and|or|not|in|is|if|else|for)\b)([^\W\d_]+(?:/s)?|°C?)"""
)
#: What differs from message to message of one topic, besides the fields of its command.
OWN = frozenset(("time", "findings", "raw", "offset", "sequence", "latency"))
_MISSING = object()
_Names = Mapping[str, Any]
_Value = Callable[[_Names], Any]
_Test = Callable[[_Names], bool]


class Kind(Enum):
    """What a name in a filter holds."""

    NUMBER = "a number"
    TEXT = "a text"
    FLAG = "true or false"
    TEXTS = "a list of texts"


@dataclass
class Meaning:
    """What a name in a filter stands for.

    `words`: the texts that it can be, or the names of its choices; empty: any. `units`: of each (dialect, command), as the
    table shows it; ("", "") for all. `low`, `high`: what its bits can hold, in that unit; None: no bound.
    """

    kind: Kind
    words: set[str] = field(default_factory=set)
    units: dict[tuple[str, str], str] = field(default_factory=dict)
    low: float | None = None
    high: float | None = None

    def add(self, dialect: str, command: str, declared: Field) -> None:
        """Let it stand for a field of one more command."""
        self.words |= set(declared.choice_names.values())
        self.units[dialect, command] = declared.unit
        if declared.kind is FieldKind.NUMBER:
            # What its bits can hold is not known here.
            self.low, self.high = -math.inf, math.inf
            return
        ends = declared.physical(declared.wire_minimum), declared.physical(declared.wire_maximum)
        self.low = min(ends) if self.low is None else min(self.low, *ends)
        self.high = max(ends) if self.high is None else max(self.high, *ends)


def _of(kind: Kind, unit: str = "", words: Iterable[str] = ()) -> Meaning:
    return Meaning(kind, set(words), {("", ""): unit})


def vocabulary(dialects: Iterable[Dialect]) -> dict[str, Meaning]:
    """Return what a filter can name in traffic of some dialects: what every message has, and the fields of the commands."""
    chosen = list(dialects)
    named = {command.name for dialect in chosen for command in (*dialect.commands, *dialect.fallbacks.values())}
    known = {
        "address": _of(Kind.NUMBER),
        "bus": _of(Kind.TEXT),
        "command": _of(Kind.TEXT, words=(*named, "unknown", "foreign")),
        "dialect": _of(Kind.TEXT, words=(dialect.name for dialect in chosen)),
        "role": _of(Kind.TEXT, words=(*Role, "junk", "event")),
        "time": _of(Kind.NUMBER, "s"),
        "latency": _of(Kind.NUMBER, "ms"),
        "checksum_ok": _of(Kind.FLAG),
        "findings": _of(Kind.TEXTS, words=(*RULES, *Severity)),
        "raw": _of(Kind.TEXT),
        "offset": _of(Kind.NUMBER),
        "section": _of(Kind.TEXT),
        "sequence": _of(Kind.NUMBER),
    }
    # Frames can name all addresses that their bits hold.
    highest = (0x1FFF_FFFF if dialect.bus == "can" else 0xFF for dialect in chosen)
    known["address"].low, known["address"].high = 0, max(highest, default=None)
    for dialect in chosen:
        for command in (*dialect.commands, *dialect.fallbacks.values()):
            forms = (*command.request_forms, *command.reply_forms, *((dialect.exception,) if dialect.exception else ()))
            for name, declared in ((n, f) for form in forms for n, f in form.layout.named.items()):
                kind = Kind.TEXT if declared.kind in NOT_NUMERIC else Kind.NUMBER
                known.setdefault(name, Meaning(kind)).add(dialect.name, command.name, declared)
                if declared.choices is not None:
                    known.setdefault(name + "_name", Meaning(Kind.TEXT)).words |= set(declared.choice_names.values())
    return known


@dataclass(frozen=True)
class _Operand:
    """One side of a comparison. `name`, `meaning`: of a name; `constant`: a number or a text as written, `unit` behind it."""

    value: _Value
    name: str = ""
    meaning: Meaning | None = None
    constant: Any = _MISSING
    unit: str = ""
    items: tuple[_Operand, ...] | None = None


_COMPARE: dict[type, tuple[str, Callable[[Any, Any], Any]]] = {
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
}
#: The same comparison with its sides exchanged.
_TURNED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
_ARITHMETIC: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Mod: operator.mod,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
}


class _Differs(Exception):
    """A name was asked for in which messages differ."""


class _Shared(dict[str, Any]):
    """The names that messages share."""

    def __init__(self, names: _Names, differing: Collection[str]) -> None:
        super().__init__(names)
        self._differing = differing

    def get(self, name: str, default: Any = None) -> Any:
        if name in self._differing:
            raise _Differs
        return super().get(name, default)


class Filter:
    """A compiled filter. Call it with the names of a message; it returns whether the message is wanted.

    `known`: what the names mean (`vocabulary`). Raises UsageError for a text that is no such expression, and for what can never
    match, with the near word.
    """

    def __init__(self, text: str, known: Mapping[str, Meaning]) -> None:
        self.text = text
        self._known = known
        tree = parsed(text)
        #: The names that it uses. A choice is compared by its name, a unit is of the dialect and the command.
        written = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        self.used = frozenset((*written, *(f"{name}_name" for name in written), "dialect", "command"))
        self._test = self._condition(tree)

    def __call__(self, names: _Names) -> bool:
        try:
            return self._test(names)
        except (TypeError, ValueError, ArithmeticError):
            return False  # what two messages of one name hold may differ: bytes in one, a number in the other

    def settled(self, names: _Names, differing: Collection[str]) -> bool | None:
        """Return the answer for all messages that share these names; None where it depends on those in which they differ.

        So one message answers for all of a topic: `command == "read_speed" and speed > 300` is False wherever the command is
        another one.
        """
        try:
            return self(_Shared(names, differing))
        except _Differs:
            return None

    def _condition(self, node: ast.AST) -> _Test:
        if isinstance(node, ast.BoolOp):
            parts = [self._condition(v) for v in node.values]
            every = all if isinstance(node.op, ast.And) else any
            return lambda names: every(part(names) for part in parts)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            inner = self._condition(node.operand)
            return lambda names: not inner(names)
        if isinstance(node, ast.Compare):
            return self._comparison(node)
        value = self._operand(node).value
        return lambda names: (found := value(names)) is not _MISSING and bool(found)

    def _comparison(self, node: ast.Compare) -> _Test:
        sides = [self._operand(n) for n in (node.left, *node.comparators)]
        tests = [self._pair(op, *pair) for op, *pair in zip(node.ops, sides, sides[1:], strict=False)]
        return tests[0] if len(tests) == 1 else lambda names: all(test(names) for test in tests)

    def _operand(self, node: ast.AST) -> _Operand:
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            inner = self._operand(node.operand)
            if isinstance(inner.constant, (int, float)):
                return _constant(-inner.constant, inner.unit)
            return _Operand(lambda names: -_number(inner.value(names)))
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            number, unit = node.left, node.right
            if isinstance(number, ast.Constant) and isinstance(unit, ast.Constant) and isinstance(number.value, (int, float)):
                return _constant(number.value, str(unit.value))
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            left, right = self._operand(node.left).value, self._operand(node.right).value
            combine = _ARITHMETIC[type(node.op)]
            return _Operand(lambda names: combine(_number(left(names)), _number(right(names))))
        if isinstance(node, ast.Name):
            name = node.id
            if name not in self._known:
                raise UsageError(f"filter: no field {name!r} in any command{_near_or_all(name, self._known)}")
            return _Operand(lambda names: names.get(name, _MISSING), name, self._known[name])
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float, str, bool)):
            return _constant(node.value)
        if isinstance(node, (ast.List, ast.Tuple, ast.Set)):
            items = tuple(self._operand(e) for e in node.elts)
            return _Operand(lambda names: [item.value(names) for item in items], items=items)
        what = type(node).__name__.lower()
        raise UsageError(f"filter: {what} is not understood; expected comparisons joined by and, or, not")

    def _pair(self, op: ast.cmpop, left: _Operand, right: _Operand) -> _Test:
        if isinstance(op, (ast.In, ast.NotIn)):
            return _among(left, right, isinstance(op, ast.In))
        if type(op) not in _COMPARE:
            raise UsageError(f"filter: {type(op).__name__.lower()} is not understood; expected == != < <= > >= in")
        sign, compare = _COMPARE[type(op)]
        if left.meaning is None and right.meaning is not None:
            left, right, sign = right, left, _TURNED[sign]
            compare = next(c for s, c in _COMPARE.values() if s == sign)
        if left.meaning is not None and right.constant is not _MISSING:
            return _checked(left, left.meaning, sign, compare, right)
        return partial(_holds, compare, left.value, right.value)


def bytes_text(frame: Frame) -> str:
    """Return what `raw` names of a frame."""
    can_id, extended = (None, False) if frame.can is None else (frame.can.id, frame.can.extended)
    return raw_text(frame.data.hex(" ").upper(), can_id, extended=extended)


def parsed(text: str) -> ast.expr:
    """Return a filter's text as a tree. Raises UsageError for what is too long or too deep, or is no expression."""
    if len(text) > _LONGEST:
        raise UsageError(f"filter of {len(text)} characters, expected at most {_LONGEST}")
    marked = _QUANTITY.sub(lambda m: m[1] or f"({m[2]} @ '{m[3]}')", text.strip())
    try:
        tree = ast.parse(marked, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        equal = "; equality is ==, not =" if _ASSIGNED.search(text) else ""
        place = f" at character {error.offset}" if isinstance(error, SyntaxError) and error.offset and marked == text else ""
        raise UsageError(f"filter {quote(text)}{place}: expected an expression such as 'address == 1'{equal}") from None
    level: list[ast.AST] = [tree]
    for _ in range(_DEEPEST):
        level = [child for node in level for child in ast.iter_child_nodes(node)]
        if not level:
            return tree
    raise UsageError(f"filter: nested deeper than {_DEEPEST}")


def _constant(value: Any, unit: str = "") -> _Operand:
    if isinstance(value, (int, float)) and not abs(value) <= _HIGHEST:
        raise UsageError(f"filter: a number beyond {_HIGHEST:.3g} can never be compared: no field holds as much")
    return _Operand(lambda names: value, constant=value, unit=unit)


def _holds(compare: Callable[[Any, Any], Any], left: _Value, right: _Value, names: _Names) -> bool:
    a, b = left(names), right(names)
    return a is not _MISSING and b is not _MISSING and bool(compare(a, b))


def _near_or_all(word: str, known: Iterable[str]) -> str:
    names = sorted(known)
    return near(word, names) or f", expected one of {', '.join(names[:12])}{' ...' * (len(names) > 12)}"


def _among(left: _Operand, right: _Operand, wanted: bool) -> _Test:
    """Return the test of `in` and `not in`: one of several values, part of a text, or a rule or severity among the findings."""
    if right.items is not None:
        if left.meaning is None:
            return partial(_holds, (lambda a, b: (a in b) is wanted), left.value, right.value)
        tests = [_checked(left, left.meaning, "==", operator.eq, item) for item in right.items if item.constant is not _MISSING]
        if len(tests) < len(right.items):
            raise UsageError(f"filter: {left.name} in a list: expected numbers and texts there")
        return lambda names: left.value(names) is not _MISSING and any(test(names) for test in tests) is wanted
    meaning = right.meaning
    if meaning is None or meaning.kind not in (Kind.TEXT, Kind.TEXTS):
        raise UsageError("filter: in: expected a list such as [1, 2], a text or findings behind it")
    if not isinstance(left.constant, str):
        raise UsageError(f"filter: in {right.name}: expected a text in quotes before it")
    if meaning.kind is Kind.TEXTS and left.constant not in meaning.words:
        raise UsageError(f"filter: {right.name} never has {quote(left.constant)}{_near_or_all(left.constant, meaning.words)}")
    return partial(_holds, (lambda a, b: (a in b) is wanted), left.value, right.value)


def _checked(left: _Operand, meaning: Meaning, sign: str, compare: Callable[[Any, Any], Any], right: _Operand) -> _Test:
    """Return the test of a name against a value as written. Raises UsageError where it can never be."""
    name, value = left.name, right.constant
    if isinstance(value, str):
        return _text_test(left, meaning, sign, compare, right)
    if meaning.kind in (Kind.TEXT, Kind.TEXTS):
        raise UsageError(f"filter: {name} is {meaning.kind.value}, got {value}; write it in quotes")
    if right.unit:
        return _quantity_test(left, meaning, compare, right)
    if not _possible(meaning, sign, value):
        raise UsageError(f"filter: {name} {sign} {value} can never be: it is {_span(meaning)}")
    return partial(_holds, compare, left.value, right.value)


def _text_test(left: _Operand, meaning: Meaning, sign: str, compare: Callable[[Any, Any], Any], right: _Operand) -> _Test:
    name, value = left.name, right.constant
    if meaning.kind in (Kind.NUMBER, Kind.FLAG) and not meaning.words:
        raise UsageError(f"filter: {name} is {meaning.kind.value}, got the text {quote(value)}; write it without quotes")
    if sign not in ("==", "!="):
        raise UsageError(f"filter: {name} {sign} {quote(value)}: texts are compared by == and !=")
    if meaning.words and value not in meaning.words:
        raise UsageError(f"filter: {name} is never {quote(value)}{_near_or_all(value, meaning.words)}")
    if meaning.kind is Kind.NUMBER:
        return partial(_holds, compare, lambda names: names.get(name + "_name", _MISSING), right.value)
    return partial(_holds, compare, left.value, right.value)


def _quantity_test(left: _Operand, meaning: Meaning, compare: Callable[[Any, Any], Any], right: _Operand) -> _Test:
    """Return the test of a name against a number with a unit, converted to the unit of each message's field."""
    factors = {of: found for of, unit in meaning.units.items() if (found := factor(right.unit, unit)) is not None}
    if not factors:
        units = sorted({unit for unit in meaning.units.values() if unit})
        told = f"it is in {' or '.join(units)}" if units else "it has no unit"
        raise UsageError(f"filter: {left.name} in {quote(right.unit)}: {told}")
    wanted = {of: right.constant * float(found) for of, found in factors.items()}
    always = wanted.get(("", ""))

    def value(names: _Names) -> Any:
        return always if always is not None else wanted.get((names["dialect"], names["command"]), _MISSING)

    return partial(_holds, compare, left.value, value)


def _possible(meaning: Meaning, sign: str, value: float) -> bool:
    """Say whether a comparison can be true for some message."""
    low = -math.inf if meaning.low is None else meaning.low
    high = math.inf if meaning.high is None else meaning.high
    return {">": value < high, ">=": value <= high, "<": value > low, "<=": value >= low}.get(sign, low <= value <= high)


def _span(meaning: Meaning) -> str:
    unit = " or ".join(sorted({unit for unit in meaning.units.values() if unit}))
    return f"{meaning.low:.10g}..{meaning.high:.10g} {unit}".rstrip()


def _number(value: Any) -> Any:
    """Return a number; texts and lists do not calculate, so that no expression can grow without bound."""
    if isinstance(value, (int, float)):
        return value
    raise TypeError("not a number")
