"""Checks of many stretches at once are those of each: the CRC of Modbus, sums of 8 bits."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from fastcrc import crc16

from analyzer.link.arrays import Crc16, Sums, running_sums

LONGEST = 40
#: Lengths of which there are many stretches, and of which there are few.
OFTEN, SELDOM = (5, 8, 13), range(5, LONGEST + 1)


def test_stretches_of_all_lengths_fit_where_they_end_with_their_own_crc():
    chance = Random(3)
    sizes = [*(chance.choice(OFTEN) for _ in range(4000)), *(chance.choice(SELDOM) for _ in range(300))]
    chance.shuffle(sizes)
    frames = []
    for number, size in enumerate(sizes):
        data = chance.randbytes(size - 2)
        check = crc16.modbus(data) ^ (1 << chance.randrange(16) if number % 3 == 0 else 0)
        frames.append(data + check.to_bytes(2, "little"))
    starts = np.cumsum([0, *sizes[:-1]])
    crc = Crc16(np.frombuffer(b"".join(frames) + bytes(LONGEST), dtype=np.uint8), LONGEST)
    fits = crc.fit_each(starts, np.array(sizes, dtype=np.uint8))
    assert fits.tolist() == [number % 3 != 0 for number in range(len(sizes))]
    eights = np.flatnonzero(np.array(sizes) == 8)
    assert crc.fit(starts[eights], 8).tolist() == fits[eights].tolist()


@pytest.mark.parametrize("count", [*range(20), 63, 64, 65, 4001])
def test_running_sums_are_those_of_all_bytes_before(count):
    data = Random(count).randbytes(count) if count % 2 else bytes([255]) * count
    codes = np.frombuffer(data, dtype=np.uint8)
    assert running_sums(codes).tolist() == [sum(data[:stop]) & 0xFF for stop in range(count + 1)]


def test_stretches_fit_where_their_sum_follows():
    data = Random(7).randbytes(3000)
    stretches = [(start, stop) for start in range(0, 2900, 3) for stop in (start, start + 1, start + 7, start + 60)]
    starts, stops = np.array(stretches).T
    fits = Sums(np.frombuffer(data, dtype=np.uint8)).fit(starts, stops)
    assert fits.tolist() == [sum(data[start:stop]) & 0xFF == data[stop] for start, stop in stretches]
    assert fits.any()
