"""The length of a CAN 2.0 data frame on the wire in bits, stuff bits included.

start | ID 11 | RTR IDE r0 | DLC 4 | data | CRC15    stuffed: after five equal bits one of the other kind
delimiter | ACK | delimiter | end 7 | gap 3          as they are
"""

from __future__ import annotations

from functools import lru_cache

#: Bits behind the CRC, with the gap before the next frame; they are never stuffed.
TAIL_BITS = 13
_POLYNOMIAL = 0x4599


def _crc15(bits: list[int]) -> int:
    register = 0
    for bit in bits:
        top = register >> 14 & 1
        register = register << 1 & 0x7FFF
        if bit ^ top:
            register ^= _POLYNOMIAL
    return register


def _bits(value: int, width: int) -> list[int]:
    return [value >> i & 1 for i in range(width - 1, -1, -1)]


@lru_cache(maxsize=4096)
def frame_bits(can_id: int, data: bytes, *, extended: bool = False, stuffed: bool = True) -> int:
    """Return the bits of a data frame on the wire, with the gap behind it."""
    if extended:
        head = [0, *_bits(can_id >> 18, 11), 1, 1, *_bits(can_id & 0x3FFFF, 18), 0, 0, 0]
    else:
        head = [0, *_bits(can_id, 11), 0, 0, 0]
    bits = head + _bits(len(data), 4)
    for byte in data:
        bits += _bits(byte, 8)
    bits += _bits(_crc15(bits), 15)
    return len(bits) + TAIL_BITS + (_stuffing(bits) if stuffed else 0)


def _stuffing(bits: list[int]) -> int:
    """Return how many bits stuffing adds; a stuffed bit counts for the run behind it."""
    added = 0
    last, run = -1, 0
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            added += 1
            last, run = 1 - bit, 1
    return added
