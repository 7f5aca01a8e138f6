"""Realism: what honest drives, lines and adapters do that the ideal emulated drive does not. Off by default, seeded.

    mks-rs485@1,real=bench              what a good drive on a good bench shows
    mks-rs485@1,real=poor               a poor line, a slow adapter, a loose loop
    mks-rs485@1,encoder-noise=1,latency=0.3..8ms,warm       single traits; they win over those of `real`

    numbers read     position, angle, encoder; speed; volts and amperes      `Hooks.result`
    requests         whether they come whole                                 `Hooks.accept`
    replies          their time, bytes around them, pauses in them           `Hooks.reply`
    shaft            off its target at rest, beyond it before it rests       by the position that is read

Traits have the same names for every dialect. None of them contradicts a manual: a drive with any of them is honest.

Rules kept here:
- Noise is bounded: a number is off by so much at most. What is drawn depends on the drive's seed alone.
- The fields of one reply come from one look at the encoder, so that raw, offset and value still fit together.
- Replies keep their order.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from msgspec.structs import replace

from analyzer.catalogue import Command, Risk, Verb
from analyzer.errors import UsageError
from analyzer.layout import Field
from analyzer.records import Frame, Message
from analyzer.values import quote
from conformance.drives.drive import Drive, Hooks, Outgoing, Values

MS = 1_000_000
#: Degrees of a count: traits of the shaft are in counts of 16384 a turn for every drive.
COUNT = 360 / 16384
_BITS_OF_A_BYTE = 10_000_000_000
#: How long a shaft swings that goes beyond its target, where nothing is said.
_SETTLE_NS = 50 * MS
#: How often a shaft swings until it rests.
_SWINGS = 2
#: How many replies have a pause in them: one of so many.
_PAUSED = 4
#: One of how many replies is stalled.
_STALLED = 40
#: From this speed on a loop lags by all that it does.
_LAGS_RPM = 60.0
#: How long a shaft creeps.
_CREEP_NS = 1000 * MS
_WARM = 62.0
#: Parts of a million in a per cent.
_PPM = 10_000
#: What a drive tells of the zero that it keeps.
_ZERO = "encoder_zero"

Span = tuple[float, float]


class Trait(NamedTuple):
    """One trait. `unit`: of its numbers, empty for a flag; `span`: it takes two numbers, as in 0.3..8ms; `signed`: a sign."""

    name: str
    unit: str
    touches: str
    source: str
    example: str
    serial: bool = False
    span: bool = False
    signed: bool = False


TRAITS: tuple[Trait, ...] = (
    Trait("encoder-noise", "counts", "positions, angles and encoder values read", "magnetic encoders of 14 bits", "1"),
    Trait("loop-error", "counts", "how far the shaft rests from its target, and its lag", "closed loops", "3"),
    Trait("speed-noise", "%", "speeds read while the shaft turns", "speeds are differences of a trembling encoder", "2%"),
    Trait("tremble", "rpm", "speeds read of a resting shaft", "speeds are differences of a trembling encoder", "1"),
    Trait("speed-lag", "ms", "how long a speed read stays behind the speed", "speeds are filtered", "20ms"),
    Trait("hysteresis", "counts", "positions read after the shaft turned the other way", "magnetic encoders", "1"),
    Trait("creep", "counts", "how far the shaft goes on in the second after it rests", "integral parts of closed loops", "2"),
    Trait("settle", "ms", "how long the shaft swings after a motion", "TRazDev/servo42es-esp32-can-controller", "50ms"),
    Trait("overshoot", "counts", "how far beyond its target the shaft swings first", "the same: 4082 of 4096 at done", "5"),
    Trait("clock", "%", "all speeds and times of the drive", "ceramic resonators and RC oscillators", "+1%", signed=True),
    Trait("latency", "ms", "how long a reply takes", "MKS drives answer in 0.3 to 8 ms", "0.3..8ms", span=True),
    Trait("latency-timer", "ms", "replies come at whole multiples of it", "FTDI adapters (pyserial PR 290)", "16ms"),
    Trait("stall", "ms", "one of forty replies is that late", "USB hubs, and hosts that do something else", "30ms"),
    Trait("first-late", "ms", "the first reply after power-on is that late", "firmware that still starts", "200ms"),
    Trait("turnaround-noise", "byte", "a byte that is none, before each reply", "transceivers without bias", "FF", serial=True),
    Trait("byte-gap", "characters", "a pause inside one of four replies", "UARTs filled by polling", "1", serial=True),
    # A damaged frame of CAN is sent again by the controllers.
    Trait("line-errors", "%", "replies with one bit turned over", "long lines without termination", "0.1%", serial=True),
    Trait(
        "request-errors", "%", "requests that come with a bit turned over, and are not taken", "the same", "0.1%", serial=True
    ),
    Trait("voltage-noise", "V", "volts and amperes read", "switching supplies", "0.2"),
    Trait("dip", "V", "volts read while the shaft turns", "supplies with long wires", "1"),
    Trait("warm", "", "the motor is at 62 degC", "any motor that works", ""),
)
BY_NAME: Mapping[str, Trait] = {trait.name: trait for trait in TRAITS}
#: Traits by the word of `real=`.
SETS: Mapping[str, Mapping[str, str]] = {
    "bench": {
        "encoder-noise": "1",
        "loop-error": "2",
        "speed-noise": "1%",
        "settle": "40ms",
        "overshoot": "3",
        "latency": "0.3..3ms",
        "voltage-noise": "0.1",
    },
    "poor": {
        "encoder-noise": "2",
        "loop-error": "4",
        "speed-noise": "2%",
        "tremble": "1",
        "settle": "80ms",
        "overshoot": "8",
        "latency": "0.3..8ms",
        "latency-timer": "16ms",
        "turnaround-noise": "FF",
        "byte-gap": "1",
        "voltage-noise": "0.3",
        "warm": "",
    },
}


def parse(dialect: str, given: Iterable[tuple[str, str]]) -> Realism | None:
    """Return the realism that words of a specification ask for, None where none does. Raises UsageError."""
    texts: dict[str, str] = {}
    for name, text in sorted(given, key=lambda each: each[0] != "real"):
        if name != "real":
            texts[name] = text
        elif text in SETS:
            texts |= SETS[text]
        else:
            raise UsageError(f"real={text}: expected real={' or real='.join(SETS)}")
    return Realism({name: _values(BY_NAME[name], text) for name, text in texts.items()}) if texts else None


def _values(trait: Trait, text: str) -> Span:
    """Return the least and the most of a trait as numbers in its unit."""
    if not trait.unit:
        if text:
            raise UsageError(f"{trait.name}: got {quote(text)}, expected no value")
        return (1.0, 1.0)
    if trait.unit == "byte" and re.fullmatch("[0-9A-Fa-f]{2}", text):
        return (float(int(text, 16)),) * 2
    number = rf"({'[+-]?' * trait.signed}\d+(?:\.\d+)?)"
    found = re.fullmatch(rf"{number}(?:\.\.{number})?\s*(?:{re.escape(trait.unit)})?", text)
    if found is None or trait.unit == "byte" or (found[2] is not None and not trait.span):
        raise UsageError(f"{trait.name}: got {quote(text)}, expected a value as in {trait.name}={trait.example}")
    low, high = float(found[1]), float(found[2] or found[1])
    if low > high:
        raise UsageError(f"{trait.name}: got {quote(text)}, expected the smaller number first")
    return low, high


@dataclass(frozen=True)
class Realism:
    """Traits with their numbers: the least and the most, in the trait's unit."""

    traits: Mapping[str, Span]

    def most(self, name: str) -> float:
        """Return the number of a trait, 0 where the drive does not have it."""
        return self.traits.get(name, (0.0, 0.0))[1]

    def install(self, hooks: Hooks) -> None:
        """Make a drive real, behind all else that changes it."""
        _Real(self).install(hooks)


class _Real:
    """The realism of one drive, with what is drawn for it."""

    def __init__(self, realism: Realism) -> None:
        self._most = realism.most
        self._latency = realism.traits.get("latency")
        self._noise_byte = realism.traits.get("turnaround-noise")
        self._chance = random.Random()
        self._drawn: tuple[float, float] = (-1.0, 0.0)
        self._seed = 0
        self._last_ns = 0
        self._answered = False
        #: The way the shaft turned last; when a speed was read, what it was and what was shown.
        self._way = 0
        self._read: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def install(self, hooks: Hooks) -> None:
        hooks.setup.append(self._setup)
        hooks.result.append(self._numbers)
        hooks.reply.append(self._reply)
        if self._most("request-errors"):
            hooks.accept.append(self._whole)

    def _setup(self, drive: Drive) -> None:
        self._seed = drive.seed
        self._chance = random.Random(f"{drive.seed} realism")
        drive.clock_ppm = round(self._most("clock") * _PPM)
        if self._most("warm"):
            drive.hot(_WARM)

    # --- numbers read ---------------------------------------------------------------------------------------------

    def _numbers(self, drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        form = next((f for f in command.reply_forms if values and f.layout.named.keys() <= values.keys()), None)
        looks = command.all_risks == {Risk.READ} or command.motion is not None or command.verb is Verb.SET_ZERO
        if values is None or form is None or not looks:
            return values
        away = self._away(drive) + self._most("encoder-noise") * COUNT * self._chance.choice((-1, 0, 0, 1))
        self._way = drive.rest.way or self._way
        away -= self._way * self._most("hysteresis") * COUNT / 2
        result = dict(values)
        for field in form.layout.named.values():
            change = _CHANGES.get(field.name)
            if change is not None and field.fixed is None:
                change(self, drive, field, result, away)
        if command.verb is Verb.SET_ZERO and _ZERO in result:
            # What is told is what was read, and it is what is kept.
            drive.store(_ZERO, result[_ZERO])
        return result

    def _away(self, drive: Drive) -> float:
        """Return how far the shaft is from where the ideal one would be, in degrees."""
        rest = drive.rest
        loop, over = self._most("loop-error"), self._most("overshoot")
        if rest.way and rest.since_ns < 0:
            # It sets off from where it rested, and falls back as it gets faster.
            share = min(1.0, abs(rest.rpm) / _LAGS_RPM)
            return ((1 - share) * self._drawn[1] - share * rest.way * loop) * COUNT
        if rest.at_ns != self._drawn[0]:
            self._drawn = (rest.at_ns, random.Random(f"{self._seed} {rest.at_ns}").uniform(-loop, loop))
        length_ns = self._most("settle") * MS or _SETTLE_NS
        done = rest.since_ns / length_ns
        swing = rest.way * over * (1 - done) ** 2 * math.cos(2 * math.pi * _SWINGS * done) if done < 1 else 0.0
        creep = rest.way * self._most("creep") * max(0.0, 1 - rest.since_ns / _CREEP_NS)
        return (self._drawn[1] + swing - creep) * COUNT

    def position(self, drive: Drive, field: Field, values: Values, away: float) -> None:
        """Move a position; that of an encoder and its turns together."""
        counts = drive.counts_per_turn
        moved = round(away / float(field.scale)) if field.unit == "deg" else round(away * counts / 360)
        turn = round(360 / field.scale) if field.unit == "deg" else counts
        # What is beyond a turn already is a lie, which noise does not mend.
        if field.name not in _IN_TURN or not 0 <= values[field.name] < turn:
            values[field.name] += moved
            return
        carry, values[field.name] = divmod(values[field.name] + moved, turn)
        if field.name == "encoder" and "carry" in values:
            values["carry"] += carry

    def error(self, drive: Drive, field: Field, values: Values, away: float) -> None:
        """Move a position error: it grows as the shaft stays back."""
        values[field.name] = _within(field, values[field.name] - round(away / float(field.scale)))

    def speed(self, drive: Drive, field: Field, values: Values, away: float) -> None:
        """Make a speed uncertain."""
        was = values[field.name] = round(self._lagged(drive, values[field.name]))
        if was:
            was += round(was * self._chance.uniform(-1, 1) * self._most("speed-noise") / 100)
        elif self._most("tremble"):
            unit = 6 if field.unit == "deg/s" else 1
            was = round(self._chance.choice((-1, 0, 1)) * self._most("tremble") * unit)
        values[field.name] = _within(field, was)

    def _lagged(self, drive: Drive, now: float) -> float:
        """Return a speed as a filter shows it, on its way since it was read last."""
        lag_ns = self._most("speed-lag") * MS
        if not lag_ns:
            return now
        read_ns, was, shown = self._read
        passed_ns = drive.now_ns - read_ns
        if now:
            # It turns as it does since then, as far as a filter shows.
            shown = now + (shown - now) * math.exp(-passed_ns / lag_ns)
        else:
            # It came to rest by a ramp, which a filter follows; then what is shown dies away.
            rests_ns = min(passed_ns, max(0.0, drive.rest.since_ns))
            if ramp_ns := passed_ns - rests_ns:
                behind = was * lag_ns / ramp_ns
                shown = behind + (shown - was - behind) * math.exp(-ramp_ns / lag_ns)
            shown *= math.exp(-rests_ns / lag_ns)
        self._read = (drive.now_ns, now, shown)
        return shown

    def supply(self, drive: Drive, field: Field, values: Values, away: float) -> None:
        """Make volts or amperes uncertain."""
        noise = self._chance.uniform(-1, 1) * self._most("voltage-noise") / float(field.scale)
        if field.unit == "V" and drive.rest.since_ns < 0:
            noise -= self._most("dip") / float(field.scale)
        values[field.name] = _within(field, values[field.name] + round(noise if field.unit == "V" else noise / 10))

    # --- requests and replies ---------------------------------------------------------------------------------------

    def _whole(self, drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        """Say whether a request comes whole: one bit that is turned over each check of these dialects sees."""
        lost = drive.dialect.bus != "can" and self._chance.random() * 100 < self._most("request-errors")
        return wanted and not lost

    def _reply(self, drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        chance, data, at_ns = self._chance, outgoing.data, outgoing.at_ns
        if self._latency is not None:
            delay_ns = round(chance.uniform(*self._latency) * MS)
            at_ns = max(drive.now_ns, at_ns - drive.reply_delay_ns) + delay_ns
        if self._most("stall") and not chance.randrange(_STALLED):
            at_ns += round(self._most("stall") * MS)
        if not self._answered:
            self._answered, at_ns = True, at_ns + round(self._most("first-late") * MS)
        timer_ns = round(self._most("latency-timer") * MS)
        if timer_ns:
            at_ns = -(-at_ns // timer_ns) * timer_ns
        at_ns = self._last_ns = max(at_ns, self._last_ns + 1)
        if drive.dialect.bus != "can":
            if data and chance.random() * 100 < self._most("line-errors"):
                place = chance.randrange(len(data))
                data = data[:place] + bytes((data[place] ^ 1 << chance.randrange(8),)) + data[place + 1 :]
            if self._noise_byte is not None:
                data = bytes((int(self._noise_byte[0]),)) + data
            gap = self._most("byte-gap")
            if gap and len(data) > 1 and not chance.randrange(_PAUSED):
                cut = chance.randrange(1, len(data))
                byte_ns = _BITS_OF_A_BYTE // drive.speed
                yield replace(outgoing, at_ns=at_ns, data=data[:cut])
                at_ns = self._last_ns = at_ns + round(byte_ns * (cut + gap))
                data = data[cut:]
        yield replace(outgoing, at_ns=at_ns, data=data)


_Change = Callable[[_Real, Drive, Field, Values, float], None]
#: Fields of angles that begin anew with each turn.
_IN_TURN = frozenset({"encoder", "encoder_raw", _ZERO, "angle"})
#: What becomes of a field, by its name.
_CHANGES: Mapping[str, _Change] = {
    **dict.fromkeys(("position", *sorted(_IN_TURN)), _Real.position),
    "angle_error": _Real.error,
    "speed": _Real.speed,
    **dict.fromkeys(("voltage", "current"), _Real.supply),
}


def _within(field: Field, value: int) -> int:
    return max(field.low, min(field.high, value))
