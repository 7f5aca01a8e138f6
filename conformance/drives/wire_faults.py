"""Faults of the wire: damage to bytes between sender and listener, by a seeded plan, in both directions.

    flip        a bit of a byte is turned over                          for each byte
    drop        a byte is lost                                          for each byte
    insert      a byte appears that was not sent                        for each byte
    pause       the line stands still for 2 to 40 ms before a byte      for each byte
    cut         the rest of what is being sent is lost                  for each sending
    collision   something else sends at the same time                   for each sending

On CAN a sending is one frame: its length is kept to 8 bytes, `insert` repeats a frame, `collision` loses it.

Each kind draws from a generator of its own, so that one rate does not change where the others strike.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass

from analyzer.errors import UsageError
from analyzer.values import near, quote

KINDS = ("flip", "drop", "insert", "pause", "cut", "collision")
#: Pauses, from longer than a Modbus silence to longer than any wait for the rest of a frame.
PAUSES_NS = (2_000_000, 5_000_000, 40_000_000)
#: Bytes that an intruder sends at most.
_INTRUSION = 8


@dataclass(frozen=True)
class Damage:
    """What became of bytes: pieces, each with the pause before it, and an intruder's bytes from one of them on."""

    pieces: tuple[tuple[int, bytes], ...]
    intruder: bytes = b""
    intruder_at: int = 0


class WireFaults:
    """A plan of faults. `rates`: by kind, 0..1; `struck` counts what has happened so far."""

    def __init__(self, rates: Mapping[str, float], seed: int = 0) -> None:
        for kind, rate in rates.items():
            if kind not in KINDS:
                raise UsageError(f"no wire fault {quote(kind)}{near(kind, KINDS)} (there are {', '.join(KINDS)})")
            if not 0 <= rate <= 1:
                raise UsageError(f"wire fault {kind}: got the rate {rate:g}, expected 0..1")
        self.rates = {kind: rate for kind, rate in rates.items() if rate}
        self.struck = dict.fromkeys(self.rates, 0)
        self._random = {kind: random.Random(f"{seed} {kind}") for kind in KINDS}

    def _strikes(self, kind: str) -> bool:
        rate = self.rates.get(kind)
        if not rate or self._random[kind].random() >= rate:
            return False
        self.struck[kind] += 1
        return True

    def on_line(self, data: bytes) -> Damage:
        """Return what becomes of bytes of one sending on a serial line."""
        if not self.rates:
            return Damage(((0, data),))
        if self._strikes("cut"):
            data = data[: self._random["cut"].randrange(len(data))]
        pieces: list[tuple[int, bytearray]] = [(0, bytearray())]
        for byte in data:
            if self._strikes("pause"):
                pieces.append((self._random["pause"].choice(PAUSES_NS), bytearray()))
            if self._strikes("insert"):
                pieces[-1][1].append(self._random["insert"].randrange(256))
            if self._strikes("drop"):
                continue
            if self._strikes("flip"):
                byte ^= 1 << self._random["flip"].randrange(8)
            pieces[-1][1].append(byte)
        kept = tuple((wait_ns, bytes(piece)) for wait_ns, piece in pieces if piece)
        if not kept or not self._strikes("collision"):
            return Damage(kept)
        chance = self._random["collision"]
        intruder = chance.randbytes(chance.randint(1, _INTRUSION))
        return Damage(kept, intruder, chance.randrange(max(1, len(data))))

    def on_can(self, data: bytes) -> tuple[tuple[int, bytes], ...]:
        """Return the data of the frames that one CAN frame becomes, each with the pause before it."""
        if not self.rates:
            return ((0, data),)
        if self._strikes("collision"):
            return ()
        if data and self._strikes("cut"):
            data = data[: self._random["cut"].randrange(len(data))]
        changed = bytearray()
        for byte in data:
            if self._strikes("drop"):
                continue
            if self._strikes("flip"):
                byte ^= 1 << self._random["flip"].randrange(8)
            changed.append(byte)
        wait_ns = self._random["pause"].choice(PAUSES_NS) if self._strikes("pause") else 0
        first = (wait_ns, bytes(changed))
        return (first, (0, first[1])) if self._strikes("insert") else (first,)


def parse_rates(text: str) -> dict[str, float]:
    """Return the rates of `flip=0.001,drop=0.01`.

    Raises UsageError for what is not a list of kinds with rates.
    """
    rates = {}
    for part in text.split(","):
        kind, equals, number = part.partition("=")
        try:
            rate = float(number)
        except ValueError:
            rate = -1.0
        if not equals or not 0 <= rate <= 1:
            raise UsageError(f"wire fault: got {quote(part)}, expected KIND=RATE with a rate 0..1, as in flip=0.001")
        rates[kind.strip()] = rate
    return rates
