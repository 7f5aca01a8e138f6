"""Noise: how much a drive and its line tremble, measured by a run before it judges (`motion.resting`); and resolutions.

    of("counts"), of("deg/s", 360), of("0.01 V")     by how much a value of this unit may be off
    step("counts")                                   the smallest difference of two values that tells something

A claim compares through both (`Probe.expect`): a difference below them is none. On a drive that reads the same again and
again the noise is zero, so that every count matters.

Rules kept here:
- A loop that trembles also rests beside its target, anew after each motion: that is no more than the bounds below.
- Noise is bounded by what the manual can allow, so that a drive cannot excuse a lie by trembling.
- Bytes of a line that nothing sends (a transceiver that turns round) are 00 or FF, and at most two of them before a reply.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

COUNT = 360 / 16384
#: The most that two rests of a shaft may differ from what was asked, in degrees: half a full step, behind which a rotor that is
#: let go falls into the next one.
_MOST_DEGREES = 0.9
#: How far from its target a loop that trembles rests at least, in degrees.
LOOP_DEGREES = 4 * COUNT
#: What a shaft swings by when it arrives, in degrees: one that trembles, and one that rests quietly.
_SWING_DEGREES, _QUIET_SWING_DEGREES = 16 * COUNT, 8 * COUNT
#: The most that a rotor may be behind its field: a full step of the motors that have 200 of them.
_MOST_LAG_DEGREES = 1.8
#: The places by which a tremble is measured are told in hundredths of a degree.
_ROUNDED_DEGREES = 0.01
#: A drive reckons speeds and times by its own clock, often a ceramic resonator or an RC oscillator: off by 2 %, with which a
#: UART still works, and what it rounds.
CLOCK_SHARE = 0.0225
#: By how much the end of a motion may be told later than it came: drives look at their shaft from time to time.
TOLD_LATE_NS = 40_000_000
#: The most that readings may tremble: a share of a speed, and other quantities by their units.
_MOST_SHARE, _MOST_RPM = 0.025, 3.0
_MOST: Mapping[str, float] = {"V": 1.0, "A": 0.5, "degC": 3.0}
#: Two looks may differ by twice the half span that was seen, and half as much again: few looks do not show all of it.
_UNSEEN = 3
#: Two counts of the coarsest encoder, of 14 bits, or two of the unit as it is told: each of two looks is rounded.
_STEPS: Mapping[str, float] = {
    "degrees": 2 * COUNT,
    "counts": 2,
    "encoder": 1,
    "rpm": 2,
    "deg/s": 2,
    "V": 0.02,
    "A": 0.02,
    "degC": 2,
}
_UNIT = re.compile(r"(?:x )?(?:(\d+(?:\.\d+)?) )?([\w/]+)")
#: A silence is so long at least, and so many times the latency of the slowest reply longer.
_LEAST_SILENCE_NS, _SILENCE_LATENCIES = 30_000_000, 5
#: A second reply follows the first one within so long, and so many times the latency.
_LEAST_QUIET_NS, _QUIET_LATENCIES = 8_000_000, 2


@dataclass(frozen=True)
class Noise:
    """Half spans measured on a resting shaft, its speed as it reads.

    `loop`: how far from its target it says that it is. `share`: of a speed, measured while the shaft turns. `lag`: how many
    degrees it went on after a stop at once. `supply`: volts, amperes and degrees Celsius by their units. `stray`, `trailing`:
    bytes of the line before and behind each reply. `repeats`: how many of the last bytes of each reply come once more.
    `checked`: whether a reply came with its checksum; one that lacks it has then lost some bytes. `latency_ns`: of its slowest
    reply. `rescaled`: whether the shaft turns at another speed than is sent, as it does at some subdivisions. `hindrance`: why
    the drive cannot turn the shaft, by its own word; empty where it can.
    """

    degrees: float = 0.0
    loop: float = 0.0
    rpm: float = 0.0
    share: float = 0.0
    lag: float = 0.0
    supply: Mapping[str, float] = field(default_factory=dict)
    stray: bytes = b""
    trailing: bytes = b""
    repeats: int = 0
    checked: bool = False
    latency_ns: int = 0
    rescaled: bool = False
    hindrance: str = ""

    @property
    def live(self) -> bool:
        """Whether the shaft trembles at all, at rest or by its speed."""
        return max(self.degrees, self.loop, self.rpm, self.share) > 0

    @property
    def settles(self) -> bool:
        """Whether a shaft that has arrived may still move a little."""
        return self.live or self.lag > 0

    @property
    def silence_ns(self) -> int:
        """How long nothing must come before it is called silence: several times what the drive's replies took."""
        return _LEAST_SILENCE_NS + _SILENCE_LATENCIES * self.latency_ns

    @property
    def quiet_ns(self) -> int:
        """How long to listen for a second reply."""
        return _LEAST_QUIET_NS + _QUIET_LATENCIES * self.latency_ns

    @property
    def place(self) -> float:
        """By how many degrees two places may differ from what was asked."""
        loop = max(self.loop * _UNSEEN / 2, LOOP_DEGREES)
        return min(_MOST_DEGREES, 2 * self.degrees + 2 * loop) if self.live else 0.0

    @property
    def swing(self) -> float:
        """By how many degrees a shaft may be off when it has just arrived."""
        most = _SWING_DEGREES if self.live else _QUIET_SWING_DEGREES
        return self.place + max(most, min(_MOST_LAG_DEGREES, 2 * self.lag))

    @property
    def counts(self) -> int:
        """By how many counts of 16384 a turn two places may differ."""
        return round(self.place / COUNT)

    @property
    def encoder(self) -> float:
        """By how many counts two looks at a resting encoder of up to 16 bits may differ."""
        return (2 * self.degrees + _ROUNDED_DEGREES) * (1 << 16) / 360 if self.degrees else 0.0

    def speed(self, rpm: float) -> float:
        """Return by how much a speed that is read may differ."""
        return min(_MOST_RPM, self.rpm) + abs(rpm) * min(_MOST_SHARE, self.share * _UNSEEN / 2)

    def of(self, unit: str, value: float = 0.0) -> float:
        """Return by how much a value of a unit may differ; 0 for what does not tremble."""
        scale, base = _parsed(unit)
        rows = {
            "degrees": self.place,
            "counts": self.counts,
            "encoder": self.encoder,
            "rpm": self.speed(value * scale),
            "deg/s": 6 * self.speed(value * scale / 6),
            **{name: min(most, _UNSEEN * self.supply.get(name, 0.0)) for name, most in _MOST.items()},
        }
        return rows.get(base, 0.0) / scale

    @staticmethod
    def step(unit: str) -> float:
        """Return by how much two values of a unit may differ that are one. Raises KeyError for a unit that has none."""
        scale, base = _parsed(unit)
        return _STEPS[base] / scale

    @property
    def figures(self) -> Mapping[str, float]:
        """What was measured, for the report."""
        found = {"degrees": self.degrees, "loop_degrees": self.loop, "rpm": self.rpm, "speed_%": 100 * self.share}
        strays = len(self.stray + self.trailing) + self.repeats
        found |= {"lag_degrees": self.lag, **self.supply, "stray_bytes": strays}
        found |= {"latency_ms": self.latency_ns / 1e6}
        return {name: round(value, 4) for name, value in found.items() if value}


def _parsed(unit: str) -> tuple[float, str]:
    """Return the scale and the first word of a unit such as `0.01 V` or `degrees from the start`."""
    found = _UNIT.match(unit)
    return (float(found[1] or 1), found[2]) if found is not None else (1.0, "")


QUIET = Noise()
