"""The index of a chunk of a log from columns: for each channel a record with times and places of its messages."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Integers
from analyzer.columns.groups import taken

_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4")])
_MESSAGE_INDEX = 7
_ENTRY = 16
#: Of a head, the bytes that its length counts: channel and size.
_COUNTED = 6


def index_records(
    channels: NDArray[np.uint16], entries: Integers, mixed: Iterable[int] = ()
) -> tuple[bytes, list[int], list[int], list[int]]:
    """Return the records, and their channels, rising, where they begin, and how many messages they have.

    `entries`: of shape (messages, 2), times and places in the order of the messages; of the channels `mixed` in any order.
    """
    counts = np.bincount(channels)
    known = np.flatnonzero(counts)
    stops = np.cumsum(counts)
    own = taken(entries.view(np.uint8), np.argsort(channels, kind="stable")).view(np.int64)
    for channel in mixed:
        each = own[stops[channel] - counts[channel] : stops[channel]]
        each[:] = each[each[:, 1].argsort()]
    sizes = counts[known] * _ENTRY
    heads = np.empty(len(known), dtype=_HEAD)
    heads["opcode"] = _MESSAGE_INDEX
    heads["length"] = sizes + _COUNTED
    heads["channel"] = known
    heads["size"] = sizes
    codes, ends = own.reshape(-1).view(np.uint8).data, stops[known] * _ENTRY
    parts: list[bytes | memoryview] = []
    at = 0
    for head, end in zip(heads.view(f"V{_HEAD.itemsize}").tolist(), ends.tolist(), strict=True):
        parts += (head, codes[at:end])
        at = end
    begins = ends - sizes + np.arange(len(known)) * _HEAD.itemsize
    return b"".join(parts), known.tolist(), begins.tolist(), counts[known].tolist()
