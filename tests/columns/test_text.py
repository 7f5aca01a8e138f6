"""Rows of pieces of any width stand side by side as text."""

from __future__ import annotations

import random

import numpy as np
import pytest

from analyzer.columns import text

GREAT = (1 << 53) - 1


def written(pieces, rows):
    """Return what rows of pieces become, each behind the room that a header takes."""
    widths = np.zeros(rows, dtype=np.int64) + text.width(pieces)
    ends = np.cumsum(widths + text.ROOM)
    out = np.full(int(ends[-1]), ord("?"), dtype=np.uint8)
    text.place(out, ends, pieces)
    return [out[end - width : end].tobytes().decode() for end, width in zip(ends.tolist(), widths.tolist(), strict=True)]


INTEGERS = [0, 1, 9, 10, 99, 9_999, 10_000, 99_999_999, 100_000_000, 999_999_999, 1_000_000_000, GREAT]
FLOATS = [0.0, -0.0, 0.1, -1.5, 1e-5, 5e-324, 1e15, 1e16, 1e17, 1 / 3, -2749094118498.5815, 123.0, 1.7976931348623157e308]


@pytest.mark.parametrize("values", [INTEGERS, [-v for v in INTEGERS], [7, -7, 12, -1200], [5], [-5]])
def test_integers(values):
    column = np.array(values, dtype=np.int64)
    assert written([b"<", text.integers(column), b">"], len(values)) == [f"<{v}>" for v in values]


def test_floats_are_as_python_writes_them():
    for values in (FLOATS, [0.1, -7.25], [12.0, -3.0, 0.0], [-0.0, 1.0], [1e15, -1e15], [float("nan"), 1.0], [1e-5, 2.5]):
        assert written([b"<", *text.floats(np.array(values)), b">"], len(values)) == [f"<{v!r}>" for v in values]


def test_pieces_of_many_widths_follow_each_other():
    chance = random.Random(1)
    rows = 300
    numbers = [chance.choice(INTEGERS) for _ in range(rows)]
    # Some names are wider than the room that stands before the shortest.
    words = ["", "a", "b" * 40, "c" * 200]
    places = [chance.randrange(4) for _ in range(rows)]
    there = [chance.random() < 0.5 for _ in range(rows)]
    data = [chance.randbytes(8) for _ in range(rows)]
    pieces = [
        b"{", text.integers(np.array(numbers)), text.of_table(np.array(places), [w.encode() for w in words]),
        text.only(np.array(there), b",part"), text.hexadecimal(np.frombuffer(b"".join(data), np.uint8).reshape(rows, 8), 5),
        text.fixed_digits(np.array(numbers) % 1000, 9), text.names(np.array(places), dict(enumerate(words))), b"}",
    ]  # fmt: skip
    expected = [
        f"{{{n}{words[p]}{',part' if t else ''}{d[:5].hex(' ').upper()}{n % 1000:09d}{words[p]}}}"
        for n, p, t, d in zip(numbers, places, there, data, strict=True)
    ]
    assert written(pieces, rows) == expected


def test_names_without_an_entry_are_an_error():
    with pytest.raises(KeyError):
        text.names(np.array([1, 2]), {1: "one"})
