"""A line that spoils what is sent: levels at sixteen steps a bit, and a receiver of its own speed, format and polarity."""

from __future__ import annotations

from random import Random
from typing import NamedTuple

STEPS = 16


class Format(NamedTuple):
    """How bytes stand on the line: `7E1` is seven data bits with an even parity."""

    bits: int = 8
    even: bool = False


BYTES = Format()


def levels(data: bytes, form: Format = BYTES, gap: int = 0) -> list[int]:
    """Return the levels of bytes, `gap` idle bits between them."""
    line: list[int] = []
    for byte in data:
        bits = [byte >> i & 1 for i in range(form.bits)]
        framed = [0, *bits, *([sum(bits) & 1] if form.even else []), 1, *[1] * gap]
        line += [level for level in framed for _ in range(STEPS)]
    return line


def both(one: list[int], other: list[int]) -> list[int]:
    """Return the levels of two senders at once: a low one wins."""
    size = max(len(one), len(other))
    one, other = one + [1] * (size - len(one)), other + [1] * (size - len(other))
    return [a & b for a, b in zip(one, other, strict=True)]


def received(
    line: list[int],
    ratio: float = 1.0,
    form: Format = BYTES,
    *,
    inverted: bool = False,
    missed: int = 0,
    shaky: Random | None = None,
) -> bytes:
    """Return what a receiver reads. `ratio`: the sender's speed over its own; `missed`: bits until it listens.

    `shaky`: each sample comes up to half a step early or late.
    """
    idle = 40 * STEPS
    line = [1] * STEPS + line + [1] * idle
    line = [1 - level for level in line] if inverted else line
    line[: STEPS * (1 + missed)] = [1] * (STEPS * (1 + missed))
    bit, at, found = STEPS * ratio, 1, []
    while at < len(line) - idle:
        if not (line[at] == 0 and line[at - 1] == 1 and line[round(at + bit / 2)] == 0):
            at += 1
            continue
        found.append(
            sum(line[int(at + (i + 1.5) * bit + (shaky.uniform(-0.5, 0.5) if shaky else 0))] << i for i in range(form.bits))
        )
        at = round(at + (1.5 + form.bits + form.even) * bit)
    return bytes(found)
