"""Links of other packages: what fails in one ends its dialect, and nothing else.

A link that raises, or answers what no link may, is named on standard error and left out. From then on it finds no frame and no
check fits, so the bytes of its dialect become junk. What would be sent is refused. Links of this package are not guarded: what
fails there is a fault of servotap.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from functools import wraps
from types import new_class
from typing import Any

from analyzer import plugins
from analyzer.errors import PluginError
from analyzer.link.interface import MORE, NO_CANDIDATES, TIE, Candidates, Check, Finder, Head, Link, Part, Role, Slicer

#: What a link is, and of which type; it is read once.
_FACTS = {"kind": str, "deciding_bytes": int, "shortest": int, "checked": bool, "tells_length": bool, "first_bytes": frozenset}

#: Says whether an answer to a question is one that may be given.
_Serves = Callable[..., bool]


def _of(kind: Any) -> _Serves:
    return lambda answer, *asked, **named: isinstance(answer, kind)


def _each(kind: Any) -> _Serves:
    return lambda answer, *asked, **named: isinstance(answer, tuple) and all(isinstance(each, kind) for each in answer)


def _is_head(answer: Any, *asked: Any, **named: Any) -> bool:
    numbers = (answer.address, answer.start, answer.stop) if isinstance(answer, Head) else (None,)
    return all(isinstance(each, int) for each in numbers) and isinstance(answer.role, Role)


#: What a link is asked that reads: what is answered for one that is left out, and what any may answer.
_READING: dict[str, tuple[Callable[..., Any], _Serves]] = {
    "parse": (lambda link, frame, can_id=None: Head(0, Role.UNKNOWN, None, None, 0, len(frame)), _is_head),
    "checks": (lambda link, frame, can_id=None: (Check("left out", len(frame), b"", b"\0"),), _each(Check)),
    "fits": (lambda *asked, **named: False, _of(bool)),
    "parts": (lambda *asked, **named: (), _each(Part)),
    "completed": (lambda link, body, can_id=None: body, _of(bytes)),
    "identifier": (lambda *asked, **named: None, _of(int | None)),
    "silence_ns": (lambda *asked, **named: 0, _of(int)),
}


def _is_length(answer: Any, buffer: bytes, at: int, end: int, closed: bool) -> bool:
    return isinstance(answer, int) and TIE <= answer <= end - at and not (closed and answer == MORE)


def _are_lengths(answer: Any, buffer: bytes, at: int, end: int) -> bool:
    return isinstance(answer, list) and all(isinstance(n, int) and (n == MORE or 0 < n <= end - at) for n in answer)


#: What a slicer is asked, and what it may answer.
_SLICING: dict[str, _Serves] = {
    "look": _is_length,
    "lengths": _are_lengths,
    "preferred": lambda answer, buffer, at, lengths: answer == 0 or answer in lengths,
    "damaged": _are_lengths,
    "foreign": _of(object),
    "whole": _of(object),
    "shortened": _are_lengths,
}


class _NoSlicer(Slicer):
    """Finds nothing."""

    heads = b""
    starts = b"(?!)"
    longest = 1

    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        return 0

    def lengths(self, buffer: bytes, at: int, end: int) -> list[int]:
        return []


class _NoFinder(Finder):
    """Finds nothing."""

    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        return NO_CANDIDATES


class _Guard:
    """What is known of one link. `why` it is left out: empty as long as it is not."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.why = ""

    def method(
        self, call: Callable[..., Any], serves: _Serves, nothing: Callable[..., Any] | None = None
    ) -> Callable[..., Any]:
        """Return a call of which what fails is left out; then it answers `nothing`, or raises PluginError."""

        @wraps(call)
        def guarded(*asked: Any, **named: Any) -> Any:
            if not self.why:
                try:
                    answer = call(*asked, **named)
                    if not serves(answer, *asked, **named):
                        raise TypeError(f"{call.__name__} gave {answer!r}")
                except BaseException as error:
                    if not plugins.is_failure(error):
                        raise
                    self.why = self.why or plugins.leave_out(self.what, error)
                # What it asked itself can have failed.
                if not self.why:
                    return answer
            if nothing is None:
                raise PluginError(f"{self.what} failed: {self.why}")
            return nothing(*asked, **named)

        return guarded


def _slicer(guard: _Guard, inner: Slicer) -> Slicer:
    found = _NoSlicer()
    found.heads, found.longest = bytes(inner.heads), int(inner.longest)
    found.starts = re.compile(inner.starts, re.DOTALL).pattern
    found.strong_head, found.strong_check = bool(inner.strong_head), bool(inner.strong_check)
    for name, serves in _SLICING.items():
        setattr(found, name, guard.method(getattr(inner, name), serves, getattr(found, name)))
    return found


def _finder(guard: _Guard, inner: Finder) -> Finder:
    def checked(*asked: Any) -> Any:
        return iter(tuple(inner.checked(*asked)))

    found = _NoFinder()
    found.longest, found.headless = int(inner.longest), bool(inner.headless)
    found.__dict__.update(at=guard.method(inner.at, _of(Candidates)), checked=guard.method(checked, _of(object)))
    return found


def guarded(what: str, link: Link) -> Link:
    """Return the link of a dialect of another package as one that harms no other dialect. Raises TypeError for a wrong one.

    `what`: as what it is named when it fails.
    """
    kind: Any = type(link)
    guard = _Guard(what)
    members: dict[str, Any] = {name: getattr(link, name) for name in _FACTS}
    for name, wanted in _FACTS.items():
        if not isinstance(members[name], wanted):
            raise TypeError(f"{name}: expected {wanted.__name__}, got {members[name]!r}")
    for name, (nothing, serves) in _READING.items():
        members[name] = guard.method(getattr(kind, name), serves, nothing)

    def slicer(*asked: Any) -> Slicer:
        return _slicer(guard, kind.slicer(*asked))

    def finder(*asked: Any) -> Finder:
        return _finder(guard, kind.finder(*asked))

    members["slicer"] = guard.method(slicer, _of(Slicer), lambda *asked: _NoSlicer())
    members["finder"] = guard.method(finder, _of(Finder))
    members["build"] = guard.method(kind.build, _of(bytes))
    members["left_out"] = property(lambda self: guard.why)
    found: Link = copy.copy(link)
    # It stays of its own class: whether a link is one with heads, or one of CAN, tells more than what it is asked here.
    object.__setattr__(found, "__class__", new_class(kind.__name__, (kind,), {}, lambda body: body.update(members)))
    return found
