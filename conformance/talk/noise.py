"""Noise: how much a shaft that rests, and its line, tremble; measured by a run before it judges (`motion.resting`).

A claim compares through it: a difference below the noise is none. On a drive that reads the same again and again it is zero,
so that every count matters.

Rules kept here:
- A loop that trembles also rests beside its target, anew after each motion: that is no more than the bounds below.
- Noise is bounded by what the manual can allow, so that a drive cannot excuse a lie by trembling.
- Bytes of a line that nothing sends (a transceiver that turns round) are 00 or FF, and at most two of them before a reply.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

COUNT = 360 / 16384
#: The most that two rests of a shaft may differ from what was asked, in degrees: less than three pulses at 16 subdivisions.
_MOST_DEGREES = 0.3
#: How far from its target a loop that trembles rests at least, in degrees.
_LOOP_DEGREES = 4 * COUNT
#: What a shaft swings by when it arrives, in degrees, and the share of a speed by which its reading trembles.
_SWING_DEGREES, _SPEED_SHARE = 16 * COUNT, 0.025
_MOST_RPM, _MOST_VOLTS = 3.0, 1.0


@dataclass(frozen=True)
class Noise:
    """Half spans measured on a resting shaft, its speed as it reads.

    `loop`: how far from its target it says that it is. `stray`: bytes of the line.
    """

    degrees: float = 0.0
    loop: float = 0.0
    rpm: float = 0.0
    volts: float = 0.0
    stray: bytes = b""

    @property
    def live(self) -> bool:
        """Whether the shaft trembles at all."""
        return max(self.degrees, self.loop, self.rpm) > 0

    @property
    def place(self) -> float:
        """By how many degrees two places may differ from what was asked."""
        return min(_MOST_DEGREES, 2 * self.degrees + 2 * max(self.loop, _LOOP_DEGREES)) if self.live else 0.0

    @property
    def swing(self) -> float:
        """By how many degrees a shaft may be off when it has just arrived."""
        return self.place + _SWING_DEGREES if self.live else 0.0

    @property
    def counts(self) -> int:
        """By how many counts of 16384 a turn two places may differ."""
        return round(self.place / COUNT)

    @property
    def encoder(self) -> float:
        """By how many counts two looks at a resting encoder of up to 16 bits may differ."""
        return 2 * self.degrees * (1 << 16) / 360

    def speed(self, rpm: float) -> float:
        """Return by how much a speed that is read may differ."""
        return min(_MOST_RPM, self.rpm) + abs(rpm) * _SPEED_SHARE if self.live else 0.0

    def of(self, unit: str, value: float = 0.0) -> float:
        """Return by how much a value of a unit may differ; 0 for what does not tremble."""
        rows = {
            "degrees": self.place,
            "counts": self.counts,
            "0.01 degrees": self.place * 100,
            "rpm": self.speed(value),
            "V": min(_MOST_VOLTS, 2 * self.volts),
        }
        return next((found for name, found in rows.items() if unit == name or unit.startswith(f"{name} ")), 0.0)

    @property
    def figures(self) -> Mapping[str, float]:
        """What was measured, for the report."""
        found = {"degrees": self.degrees, "loop_degrees": self.loop, "rpm": self.rpm, "volts": self.volts}
        found["stray_bytes"] = len(self.stray)
        return {name: round(value, 4) for name, value in found.items() if value}


QUIET = Noise()
