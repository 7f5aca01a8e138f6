"""The index of a chunk of a log from columns: for each channel a record with times and places of its messages."""

from __future__ import annotations

import numpy as np

from analyzer.columns import text
from analyzer.columns.codec import Integers
from analyzer.columns.groups import taken

_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4")])
_MESSAGE_INDEX = 7
_ENTRY = 16
#: Of a head, the bytes that its length counts: channel and size.
_COUNTED = 6


def index_records(channels: Integers, log_ns: Integers, places: Integers) -> tuple[bytes, list[tuple[int, int, int]]]:
    """Return the records, and of each its channel, where it begins, and how many messages it has; channels rising.

    There is one entry a message, in the order of the messages.
    """
    order = np.argsort(channels.astype(np.uint16), kind="stable")
    own = channels.take(order)
    firsts = np.flatnonzero(np.diff(own, prepend=-1))
    counts = np.diff(firsts, append=len(own))
    begins = np.arange(len(firsts)) * _HEAD.itemsize + firsts * _ENTRY
    data = np.empty(len(firsts) * _HEAD.itemsize + len(own) * _ENTRY, dtype=np.uint8)
    heads = np.empty(len(firsts), dtype=_HEAD)
    heads["opcode"] = _MESSAGE_INDEX
    heads["length"] = counts * _ENTRY + _COUNTED
    heads["channel"] = own[firsts]
    heads["size"] = counts * _ENTRY
    text.put(data, begins + _HEAD.itemsize, heads.view(np.uint8).reshape(len(heads), _HEAD.itemsize))
    entries = np.empty((len(own), 2), dtype=np.int64)
    entries[:, 0], entries[:, 1] = log_ns, places
    # Behind as many heads as there are channels up to its own.
    ends = np.arange(_ENTRY, (len(own) + 1) * _ENTRY, _ENTRY)
    ends += np.repeat(np.arange(1, len(firsts) + 1) * _HEAD.itemsize, counts)
    text.put(data, ends, taken(entries.view(np.uint8), order))
    return data.tobytes(), list(zip(own[firsts].tolist(), begins.tolist(), counts.tolist(), strict=True))
