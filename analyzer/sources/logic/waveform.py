"""What a reader of raw levels gives: the channels, and their edges in stretches of time, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Flags, Integers
from analyzer.values import SECOND_NS

#: Channels of one capture; a capture with more is damaged or hostile.
CHANNEL_LIMIT = 512


class Stretch(NamedTuple):
    """Edges of each channel in ns, and the time up to which there are no others."""

    edges: list[Integers]
    end_ns: int


@dataclass
class Waveform:
    """A capture of levels. `first`: the level of each channel at its beginning, known with the first stretch.

    `step_ns`: between two samples, 0 where that is not known. `rated` False: the capture does not say how long a sample is, so
    its times are sample numbers.
    """

    names: list[str]
    stretches: Iterator[Stretch]
    step_ns: float = 0.0
    rated: bool = True
    first: list[int] = field(default_factory=list)


def sample_times(numbers: Integers, rate: int) -> Integers:
    """Return the times in ns of samples at a rate in samples a second; no product exceeds an integer of 64 bits."""
    seconds, rest = np.divmod(numbers, rate)
    times: Integers = seconds * SECOND_NS + rest * SECOND_NS // rate
    return times


#: Samples of many channels: unsigned words of any width.
Words = NDArray[np.unsignedinteger[Any]]


def changes(words: Words, before: int) -> tuple[Integers, Words]:
    """Return where words differ from the one before them, and in which bits."""
    previous = np.empty_like(words)
    previous[0], previous[1:] = before, words[:-1]
    differs: Flags = words != previous
    places = np.flatnonzero(differs).astype(np.int64)
    return places, words[places] ^ previous[places]


def of_bit(places: Integers, changed: Words, bit: int) -> Integers:
    """Return the places where one bit changed."""
    ones: Flags = (changed >> changed.dtype.type(bit) & changed.dtype.type(1)).astype(bool)
    return places[ones]
