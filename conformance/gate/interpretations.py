"""What can be read in what leaves: every frame, at any offset, in any dialect, whole or cut off, its checks right or wrong.

    sent before (as far as it can still matter) + what is to leave -> readings, each with its risks

A line is a stream: a frame may be cut into several sendings, and a drive keeps what it has for as long as it likes. So the
end of what was sent stays here until nothing that begins in it can go on, and time clears nothing.

Which readings count. A frame is good where its checks fit and its code is in the catalogue.

1. A frame whose checks fit counts, wherever it stands.
2. A known frame whose checks do not fit counts too, wherever it stands, and so does one that is cut off as soon as its code
   can be read, with the worst of the values that are missing. So no first piece can leave whose last piece could not.
3. A code outside the catalogue counts wherever a head stands before it. Where a head byte stands in place of the code, it
   is the next frame's. LK's head is a common byte: there the sum of the head has to fit, or a sending has to begin with it.
4. Modbus has no heads, so any two bytes could be a frame: writes of registers outside the catalogue whose CRC does not fit
   count where a sending begins, for there a Modbus drive begins to read; other functions count where their CRC fits.

Exceptions, without which ordinary reads would be refused. None is for a frame whose checks fit (one of a code outside the
catalogue must check within the good frame it stands in), and none hides a frame that is sent by itself:

- The reading begins inside a good frame, goes on beyond its end, and every byte of it belongs to good frames: two good
  frames, seen by somebody out of step (`3E 9C 20 00 [FA | 3E 9A 20 00 F8]`).
- Its code belongs to a good frame that began later than itself: a head that was left over, and a good frame behind it.
- It is a slot of a package that does not check, or a code outside the catalogue, and its code belongs to a good frame.

On CAN a frame is a frame: one reading for each dialect, by its code, whatever its sum.

Not known here: what is allowed (`conformance.gate.permissions`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from analyzer.catalogue import Command, Dialect, Form, Risk
from analyzer.dialects import code_text
from analyzer.records import CanFrame
from analyzer.values import value_text
from conformance.gate.links import LONGEST, ear
from conformance.gate.modbus import ModbusEar
from conformance.gate.spots import Meaning, Spot, meanings

UNKNOWN = frozenset({Risk.UNKNOWN})
_CAN_ID_LIMIT = 0x7FF
#: Results that are kept: hosts say the same things again and again.
_KEPT = 8192


@dataclass(frozen=True, slots=True)
class Reading:
    """A frame that can be read in what is to leave.

    `address` None: it has not come yet, or it is of no one drive (a package). `command` None: its code is not in the
    catalogue. `values`: integers as sent, of the fields that are there. `offset`: of its first byte from the first byte
    that is to leave; below 0 it began in an earlier sending. `data`: its bytes as far as they are there. `slot`: number of
    the slot of a package, 0 for none. `to_many`: no one drive is meant: all, or a package.
    """

    dialect: Dialect
    address: int | None
    code: int
    command: Command | None
    form: Form | None
    values: Mapping[str, int]
    risks: frozenset[Risk]
    offset: int
    data: bytes
    sound: bool
    complete: bool
    slot: int = 0
    to_many: bool = False
    note: str = ""

    @property
    def reads_only(self) -> bool:
        """Whether it does nothing but read."""
        return self.risks <= _READ

    def __str__(self) -> str:
        """Return it for people: who, what, where, and how well it reads."""
        who = "all" if self.address is None or self.to_many else str(self.address)
        wide = self.dialect.link.kind == "serial" and bool(self.dialect.fallbacks)
        name = self.command.name if self.command is not None else f"code {code_text(self.code, 0 if wide else None)}"
        shown = [f"{n}={_shown(self.form, n, v)}" for n, v in self.values.items()]
        told = [f"slot {self.slot}"] * bool(self.slot)
        told += [] if self.offset == 0 else [f"from byte {self.offset}" if self.offset > 0 else "begun in an earlier sending"]
        told += ["cut off"] if not self.complete else ["its check is wrong"] if not self.sound else []
        told += [self.note] * bool(self.note)
        return " ".join([f"{self.dialect.name}@{who} {name}", *shown]) + (f" ({', '.join(told)})" if told else "")


_READ = frozenset({Risk.READ})


def _shown(form: Form | None, name: str, value: int) -> str:
    field = form.layout.named.get(name) if form is not None else None
    return str(value) if field is None else value_text(field, value)


class Stream(NamedTuple):
    """What was sent before, from where something in it can still go on.

    `starts`: where sendings begin in it; `good`: the good frames in it, first byte and the one behind the last.
    """

    tail: bytes = b""
    starts: tuple[int, ...] = ()
    good: tuple[tuple[int, int], ...] = ()


class SerialReader:
    """Reads what leaves on a serial line."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self._ears = [ear(d) for d in dialects]
        self._modbus = [e for e in self._ears if isinstance(e, ModbusEar)]
        self._kept: dict[tuple[Stream, bytes], tuple[tuple[Reading, ...], Stream]] = {}

    def read(self, stream: Stream, item: bytes) -> tuple[tuple[Reading, ...], Stream]:
        """Return what can be read once `item` has left, of which at least a byte is in it, and the stream behind it."""
        key = (stream, item)
        found = self._kept.get(key)
        if found is None:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            found = self._kept[key] = self._read(stream, item)
        return found

    def _read(self, stream: Stream, item: bytes) -> tuple[tuple[Reading, ...], Stream]:
        buffer, new = stream.tail + item, len(stream.tail)
        spots: list[Spot] = []
        opens: list[int] = []
        for at in range(len(buffer)):
            for each in self._ears:
                found = each.look(buffer, at)
                spots += [s for s in found.spots if min(s.stop, s.until) > new]
                if found.open:
                    opens.append(at)
        good = _Good([*stream.good, *((s.start, s.stop) for s in spots if s.known and s.sound and not s.slot)])
        starts = (*stream.starts, new)
        for modbus in self._modbus:
            begins = [*stream.starts, *range(new, len(buffer))]
            begins = [at for at in begins if not good.holds(at, len(buffer))]
            spots += [s for s in modbus.windows(buffer, begins, new) if not good.holds(s.start, s.stop)]
            # A function that nobody knows may still come to check: it is followed from where sendings begin, until a
            # good frame has ended one.
            if not any(stop == len(buffer) for _, stop in good.spans):
                opens += starts
        readings = tuple(
            reading
            for spot in sorted(spots, key=lambda s: (s.start, s.slot))
            if _counts(spot, good, starts)
            for reading in readings_of(spot, buffer, new)
        )
        return readings, _rest(buffer, opens, starts, good)


class _Good:
    """The good frames of a buffer."""

    def __init__(self, spans: Sequence[tuple[int, int]]) -> None:
        self.spans = spans

    def has(self, at: int) -> bool:
        """Say whether a byte belongs to one."""
        return any(start <= at < stop for start, stop in self.spans)

    def holds(self, start: int, stop: int) -> bool:
        """Say whether a stretch lies within one."""
        return any(a <= start and stop <= b for a, b in self.spans)

    def begins(self, start: int, at: int) -> bool:
        """Say whether one that has the byte `at` begins behind `start`."""
        return any(start < a <= at < b for a, b in self.spans)

    def out_of_step(self, spot: Spot) -> bool:
        """Say whether a reading begins inside one, goes on beyond its end, and has no byte that belongs to none."""
        at, stop = spot.start, spot.stop
        beyond = any(a < at < b and (stop > b or not spot.complete) for a, b in self.spans)
        return beyond and all(self.has(n) for n in range(at, stop))


def _counts(spot: Spot, good: _Good, starts: tuple[int, ...]) -> bool:
    explained = good.has(spot.code_at)
    if spot.sound:
        return spot.known or not explained or good.holds(spot.start, spot.stop)
    if spot.known and not spot.slot:
        return not (good.begins(spot.start, spot.code_at) or good.out_of_step(spot))
    return not (explained or spot.weak or (spot.only_first and spot.start not in starts))


def _rest(buffer: bytes, opens: Sequence[int], starts: Sequence[int], good: _Good) -> Stream:
    first = max(min(opens, default=len(buffer)), len(buffer) - LONGEST)
    return Stream(
        buffer[first:],
        tuple(s - first for s in starts if s >= first and s < len(buffer)),
        tuple(sorted({(max(a - first, -1), b - first) for a, b in good.spans if b > first})),
    )


def readings_of(spot: Spot, buffer: bytes, new: int) -> list[Reading]:
    """Return the readings of a spot: one for each thing it may mean, those left out that another one outdoes."""
    data = buffer[spot.start : spot.stop]
    dialect = spot.dialect
    to_many = spot.slot > 0 or (spot.address is None and spot.complete) or spot.address == dialect.broadcast

    def reading(meaning: Meaning | None) -> Reading:
        command, form, values, risks = meaning or (None, None, {}, UNKNOWN)
        if not spot.known and not spot.slot:
            risks = risks | UNKNOWN
        return Reading(
            dialect, spot.address, spot.code, command, form, values, risks, spot.start - new, data, spot.sound,
            spot.complete, spot.slot, bool(to_many), spot.note,
        )  # fmt: skip

    if not spot.meanings:
        return [reading(None)]
    told = spot.meanings
    kept = [m for i, m in enumerate(told) if not any(m.risks < o.risks or (m.risks == o.risks and n > i)
            for n, o in enumerate(told) if n != i)]  # fmt: skip
    return [reading(m) for m in kept]


# --- CAN ----------------------------------------------------------------------------------------------------------


class CanReader:
    """Reads what leaves on a CAN bus: each frame is judged by itself."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self._dialects = tuple(dialects)
        self._kept: dict[tuple[int, bytes, bool], tuple[Reading, ...]] = {}

    def read(self, frame: CanFrame) -> tuple[Reading, ...]:
        """Return what can be read in a frame, in each dialect."""
        plain = not (frame.extended or frame.remote or frame.error or frame.fd) and frame.id <= _CAN_ID_LIMIT
        key = (frame.id, frame.data, plain)
        found = self._kept.get(key)
        if found is None or not plain:
            found = tuple(r for d in self._dialects for r in self._read(d, frame, "" if plain else _kind(frame)))
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            if plain:
                self._kept[key] = found
        return found

    def _read(self, dialect: Dialect, frame: CanFrame, strange: str) -> list[Reading]:
        data, can_id = frame.data, frame.id
        note = strange or ("" if data else "a frame without data")
        commands = dialect.by_code.get(data[0], ()) if data else ()
        sound = len(data) > 1 and dialect.link.fits(data, can_id)
        own = data[1:-1]
        # Without data of its own a command that is there at all is what it is, its sum there or not.
        told = meanings(commands, own, len(own)) if commands else ()
        if len(data) < 2:
            told = tuple(Meaning(c, None, {}, c.risks({})) for c in commands)
        spot = Spot(
            dialect, 0, len(data), can_id, data[0] if data else 0, 0, len(data), bool(told) and not strange, sound,
            len(data) > 1, told, note=note,
        )  # fmt: skip
        return readings_of(spot, data, 0)


def _kind(frame: CanFrame) -> str:
    """Return in words why a frame is not a plain one of 11 bits."""
    kinds = ((frame.error, "an error frame"), (frame.fd, "a CAN FD frame"), (frame.remote, "a remote frame"))
    return next((text for is_so, text in kinds if is_so), "an identifier of 29 bits")
