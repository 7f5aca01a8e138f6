"""The CRC of Modbus over many stretches at once is the CRC of each."""

from __future__ import annotations

from random import Random

import numpy as np
from fastcrc import crc16

from analyzer.link.arrays import Crc16

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
