"""Protocols that are not known here, by what most protocols have: letters, or a check of a usual kind at the end of frames.

A wrongly set up line shows neither: few of its bytes are letters, and they fit a check only by chance.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

from analyzer.diagnosis.check_rules import RULES
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link import FUNCTIONS, modbus_crc
from analyzer.values import counted

#: The fewest and the most bytes of a frame that is looked at, and the fewest different frames.
_SHORTEST, _LONGEST, _FEWEST = 5, 128, 3
#: The share of frames that must fit the check.
_MOST = 0.8
#: Frames that are looked at: more of the same shows nothing new.
_LOOKED_AT = 50
#: Bytes before and behind what the check is over.
_BEFORE, _BEHIND = range(3), range(2)
#: The fewest bytes of text, the fewest different ones, and the share of letters: noise changes one here and there.
_TEXT, _DIFFERENT, _PRINTED = 16, 8, 0.9
_PRINTABLE = frozenset(b"\t\n\r") | frozenset(range(0x20, 0x7F))
#: Bytes that tell one check from another.
_CHECKED = b"\1\2\3"
_HEX_DIGITS = re.compile(rb"[0-9A-Fa-f\s,x:]+")


class _Fit(NamedTuple):
    """A check that most frames have. `rule`: its name; `before`, `behind`: bytes that it leaves out."""

    rule: str
    before: int
    behind: int
    frames: list[tuple[Trouble, bytes]]


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a protocol that is not known here, where no frame of a known one came."""
    if any(piece.sound for piece in scene.pieces):
        return
    bursts = [
        (t, t.stretch.data)
        for t in scene.damaged
        if t.stretch is not None
        and t.stretch.can_id is None
        and t.stretch.opens
        and t.stretch.ends
        and t not in scene.explained
    ]
    text = _text([data for _, data in bursts])
    if text:
        first, data = bursts[0]
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, [t for t, _ in bursts],
            "What comes is text, a protocol of letters, which is not known here.",
            f"{text!r} at byte {first.offset}; {counted(len(bursts), 'time')}",
            "Use the library of the device's maker; the dialects known here are those of `servotap catalogue`",
            (Shown(first.offset, shown(data)),),
        )  # fmt: skip
        return
    fit = _checked(scene, bursts[:_LOOKED_AT])
    if fit is not None:
        first, data = fit.frames[0]
        left = f", without the first {counted(fit.before, 'byte')}" if fit.before else ""
        end = " before a last byte that is always the same" if fit.behind else ""
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, [t for t, _ in bursts],
            f"The frames are whole, of a protocol that is not known here: each has {fit.rule}{left}{end}.",
            f"{shown(data)} at byte {first.offset}; {counted(len(fit.frames), 'frame')} like it",
            "Use the manual or the library of the device's maker; the dialects known here are those of `servotap catalogue`",
            tuple(Shown(t.offset, shown(d)) for t, d in fit.frames),
        )  # fmt: skip


def _text(bursts: list[bytes]) -> str:
    """Return the beginning of what comes where it is text, and no digits of bytes; empty where it is none."""
    data = b"".join(bursts)
    printed = sum(byte in _PRINTABLE for byte in data)
    if len(data) < _TEXT or len(set(data)) < _DIFFERENT or printed < _PRINTED * len(data):
        return ""
    # Digits of bytes are a host's mistake, and have a cause of their own.
    return "" if _HEX_DIGITS.fullmatch(data) else data[:_TEXT].decode("ascii", "replace").strip()


def _checked(scene: Scene, bursts: list[tuple[Trouble, bytes]]) -> _Fit | None:
    """Return a check that most frames have, if their heads are not those of a known dialect."""
    frames = {data: trouble for trouble, data in reversed(bursts) if _SHORTEST <= len(data) <= _LONGEST}
    if len(frames) < _FEWEST or 2 * sum(_is_ours(scene, data) for data in frames) > len(frames):
        return None
    # What a line makes of a right check has a cause of its own.
    rules = [rule for rule in RULES if rule.cause != "wrong_parity"]
    for rule, before, behind in product(rules, _BEFORE, _BEHIND):
        if behind and len({data[-1] for data in frames}) > 1:
            continue
        # A frame whose Modbus CRC fits is of Modbus, also with a function that is not known here.
        if not before and not behind and rule.of(_CHECKED, 0) == modbus_crc(_CHECKED).to_bytes(2, "little"):
            continue
        fitting = [(t, data) for data, t in frames.items() if _fits(rule.of, data[before : len(data) - behind])]
        if len(fitting) >= max(_FEWEST, _MOST * len(frames)) and len({data for _, data in fitting}) >= _FEWEST:
            return _Fit(rule.name, before, behind, sorted(fitting, key=lambda row: row[0].offset))
    return None


def _is_ours(scene: Scene, data: bytes) -> bool:
    return data[0] in scene.reader.heads or data[1] & 0x7F in FUNCTIONS


def _fits(of: Callable[[bytes, int], bytes], data: bytes) -> bool:
    size = len(of(b"\1\2", 0))
    return len(data) > size + 1 and of(data[:-size], 0) == data[-size:]
