"""The index of a chunk of a log from columns: for each channel a record with times and places of its messages."""

from __future__ import annotations

import numpy as np

from analyzer.columns import text
from analyzer.columns.codec import Integers

_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4")])
_MESSAGE_INDEX = 7
_ENTRY = 16
#: Of a head, the bytes that its length counts: channel and size.
_COUNTED = 6


def index_records(channels: Integers, log_ns: Integers, places: Integers) -> tuple[bytes, dict[int, int], dict[int, int]]:
    """Return the records, where each channel's begins in them, and how many messages it has; channels rising.

    There is one entry a message, in the order of the messages.
    """
    order = np.argsort(channels.astype(np.uint16), kind="stable")
    own = channels[order]
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
    entries = np.stack((log_ns[order], places[order]), axis=1)
    ends = np.repeat(begins - firsts * _ENTRY, counts) + _HEAD.itemsize + np.arange(1, len(own) + 1) * _ENTRY
    text.put(data, ends, entries.view(np.uint8).reshape(len(entries), _ENTRY))
    names = own[firsts].tolist()
    return data.tobytes(), dict(zip(names, begins.tolist(), strict=True)), dict(zip(names, counts.tolist(), strict=True))
