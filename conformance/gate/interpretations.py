"""Interpretations: every request that some drive could take from the bytes that are to leave.

    bytes sent before + bytes to leave -> interpretations, each with its risks

A link finds the candidates (`Link.finder`): at any offset, whole or cut off, with right or wrong checks. This module decides
which of them count, and what each may mean. A serial line is a stream: a frame may be cut into several sendings, and a drive
may keep a part for any time. So the end of the sent bytes stays in `Pending` until no frame that begins in it can go on.

Which candidates count. A frame is good if its checks fit and its code is in the catalogue.

1. A frame whose checks fit counts everywhere.
2. A known frame whose checks do not fit counts everywhere too. One that is cut off counts as soon as its code has come, with
   the worst of the values that are missing. So no first piece can leave whose last piece could not.
3. A code outside the catalogue counts everywhere behind a head. A head byte in place of a code belongs to the next frame. The
   head of LK is a common byte: there the sum of the head has to fit, or a sending has to begin with it.
4. Modbus has no heads, so any two bytes could be a frame. Writes of uncatalogued registers whose CRC does not fit count where a
   sending begins, for there a Modbus drive begins to read. Other functions count where their CRC fits.

Exceptions, without which ordinary reads would be refused. They never drop a frame whose checks fit, or a frame that is sent
alone. Only a frame of an uncatalogued code that checks beyond the good frame around it is dropped too:

- The candidate begins inside a good frame, goes on beyond its end, and all its bytes belong to good frames: a drive that is out
  of step reads two good frames so (`3E 9C 20 00 [FA | 3E 9A 20 00 F8]`).
- Its code belongs to a good frame that began later than itself: a head that was left over, and a good frame behind it.
- It is a slot of a package that does not check, or has an uncatalogued code, and its code belongs to a good frame.

On CAN each frame is judged by itself: it has one interpretation in each dialect, even with a wrong sum. A good frame of a
catalogued length is interpreted only in the dialects where it is good: drives of several makers share a bus.

Not known here: what is allowed (`conformance.gate.permissions`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from analyzer.catalogue import Command, Dialect, Form, Risk
from analyzer.codec import codec
from analyzer.dialects import code_text, drive_name
from analyzer.layout import FieldKind
from analyzer.link import Candidate
from analyzer.records import CanFrame
from analyzer.values import value_text

UNKNOWN = frozenset({Risk.UNKNOWN})
_CAN_ID_LIMIT = 0x7FF
#: Results that are kept: hosts say the same things again and again.
_KEPT = 8192


@dataclass(frozen=True, slots=True)
class Interpretation:
    """A request that some drive could take from the bytes that are to leave.

    `address` None: it has not come yet, or no one drive is meant (a package). `command` None: its code is not in the catalogue.
    `values`: integers as sent, of the fields that have come. `offset`: place of its first byte, from the first byte to leave;
    below 0 it began in an earlier sending. `data`: its bytes that have come; `fits`: all have, and its checks are right.
    `slot`: number of the slot of a package, 0 for none. `to_many`: all drives are meant, or those of a package.
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
    fits: bool
    complete: bool
    slot: int = 0
    to_many: bool = False
    note: str = ""

    @property
    def reads_only(self) -> bool:
        """Whether it does nothing but read."""
        return self.risks <= _READ

    def covers(self, at: int) -> bool:
        """Say whether a byte belongs to it."""
        return self.offset <= at < self.offset + len(self.data)

    def __str__(self) -> str:
        """Return it for people: which drive, what, and why it is doubtful."""
        many = self.address is None or self.to_many
        who = f"{self.dialect.name}@all" if many or self.address is None else drive_name(self.dialect, self.address)
        wide = self.dialect.link.kind == "serial" and bool(self.dialect.fallbacks)
        name = self.command.name if self.command is not None else f"code {code_text(self.code, 0 if wide else None)}"
        shown = [f"{n}={_shown(self.form, n, v)}" for n, v in self.values.items()]
        told = [f"slot {self.slot}"] * bool(self.slot)
        told += [] if self.offset == 0 else [f"from byte {self.offset}" if self.offset > 0 else "begun in an earlier sending"]
        told += ["cut off"] if not self.complete else ["its check is wrong"] if not self.fits else []
        told += [self.note] * bool(self.note)
        return " ".join([f"{who} {name}", *shown]) + (f" ({', '.join(told)})" if told else "")


_READ = frozenset({Risk.READ})


def _shown(form: Form | None, name: str, value: int) -> str:
    field = form.layout.named.get(name) if form is not None else None
    return str(value) if field is None else value_text(field, value)


class Pending(NamedTuple):
    """The end of what was sent: from where the first frame begins that can still go on.

    `starts`: where sendings begin in it; `good`: the good frames in it, first byte and the one behind the last.
    """

    tail: bytes = b""
    starts: tuple[int, ...] = ()
    good: tuple[tuple[int, int], ...] = ()


class _Dialect:
    """A dialect, the finder of its requests, and what a candidate of it may mean."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self.finder = dialect.link.finder(dialect.commands)
        self._commands: dict[tuple[int | None, int], tuple[Command, ...]] = {}
        for command in dialect.commands:
            key = (command.function, command.code)
            self._commands[key] = (*self._commands.get(key, ()), command)

    def fallback(self, candidate: Candidate) -> Command | None:
        """Return the command that stands for an uncatalogued use of a standard function."""
        return None if candidate.known or candidate.function is None else self.dialect.fallbacks.get(candidate.function)

    def known(self, candidate: Candidate) -> bool:
        """Say whether it is clear what a candidate does: it is catalogued, or its function does nothing but read."""
        fallback = self.fallback(candidate)
        return candidate.known or (fallback is not None and fallback.all_risks <= _READ)

    def good(self, candidate: Candidate) -> bool:
        """Say whether a candidate is a good frame whose data are as long as the catalogue has them."""
        return candidate.fits and candidate.known and all(m.form is not None for m in self.meanings(candidate))

    def meanings(self, candidate: Candidate) -> list[_Meaning]:
        """Return what a candidate may mean; a meaning that another one outdoes is left out."""
        fallback = self.fallback(candidate)
        if fallback is not None:
            return [_worst(fallback)]
        if not candidate.known:
            return [_Meaning(None, None, {}, UNKNOWN)]
        commands = self._commands[candidate.function, candidate.code]
        if commands[0].slots is not None:
            # The package itself does nothing; what it does stands in its slots.
            return [_Meaning(commands[0], None, {}, _READ)]
        if candidate.misfit:
            # A write of registers also writes some that the command does not own.
            beside = frozenset[Risk]() if candidate.function is None else UNKNOWN
            found = [_Meaning(c, None, {}, c.risks({}) | beside) for c in commands]
        else:
            # Data can be longer than the command in a slot alone.
            found = [m for size in candidate.sizes or (None,) for m in _meanings(commands, candidate.data[:size], size)]
        return [
            m
            for i, m in enumerate(found)
            if not any(m.risks < o.risks or (m.risks == o.risks and n > i) for n, o in enumerate(found) if n != i)
        ]

    def interpretations(
        self, candidate: Candidate, buffer: bytes, new: int, beside: frozenset[Risk] = frozenset()
    ) -> Iterator[Interpretation]:
        """Yield a candidate's interpretations. `new`: where the bytes to leave begin; `beside`: further risks of each."""
        at, stop, slot = candidate.start, candidate.stop, candidate.slot
        to_many = slot > 0 or (candidate.address is None and candidate.complete) or candidate.address == self.dialect.broadcast
        if not self.known(candidate) and not slot:
            beside = beside | UNKNOWN
        for command, form, values, risks in self.meanings(candidate):
            yield Interpretation(
                self.dialect,
                candidate.address,
                candidate.code,
                command,
                form,
                values,
                risks | beside,
                at - new,
                buffer[at:stop],
                candidate.fits,
                candidate.complete,
                slot,
                to_many,
                candidate.note,
            )


def _of(dialect: Dialect) -> _Dialect:
    """Return what interprets a dialect, made once and kept with it: each claim on an emulated drive has a gate of its own."""
    kept: _Dialect | None = dialect.__dict__.get("_interpreted")
    if kept is None:
        kept = dialect.__dict__["_interpreted"] = _Dialect(dialect)
    return kept


@lru_cache(maxsize=32)
def _known(*dialects: _Dialect) -> dict[Any, Any]:
    """Return where the interpretations of these dialects are kept, for all gates together: they depend on nothing else."""
    return {}


class SerialInterpreter:
    """Interprets what leaves on a serial line."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self._dialects = [_of(d) for d in dialects]
        self._longest = max((d.finder.longest for d in self._dialects), default=0)
        self._kept: dict[tuple[Pending, bytes], tuple[tuple[Interpretation, ...], Pending]] = _known(*self._dialects)

    def interpret(self, pending: Pending, item: bytes) -> tuple[tuple[Interpretation, ...], Pending]:
        """Return the interpretations that need a byte of `item`, and what is pending behind it."""
        key = (pending, item)
        known = self._kept.get(key)
        if known is None:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            known = self._kept[key] = self._interpret(pending, item)
        return known

    def _interpret(self, pending: Pending, item: bytes) -> tuple[tuple[Interpretation, ...], Pending]:
        buffer, new = pending.tail + item, len(pending.tail)
        candidates: list[tuple[Candidate, _Dialect]] = []
        opens: list[int] = []
        for at in range(len(buffer)):
            for each in self._dialects:
                found, is_open = each.finder.at(buffer, at)
                candidates += [(c, each) for c in found if min(c.stop, c.judged_to) > new]
                if is_open:
                    opens.append(at)
        good = _Good([*pending.good, *((c.start, c.stop) for c, d in candidates if c.fits and not c.slot and d.known(c))])
        starts = (*pending.starts, new)
        for each in self._dialects:
            if not each.finder.headless:
                continue
            begins = [at for at in (*pending.starts, *range(new, len(buffer))) if not good.holds(at, len(buffer))]
            checked = (c for at in begins for c in each.finder.checked(buffer, at, new + 1))
            candidates += [(c, each) for c in checked if not good.holds(c.start, c.stop)]
            # An unknown function may still come to check. It is followed from where sendings begin, until a good frame has
            # ended one.
            if not any(stop == len(buffer) for _, stop in good.spans):
                opens += starts
        counting = tuple(
            interpretation
            for candidate, each in sorted(candidates, key=lambda c: (c[0].start, c[0].slot))
            if _counts(candidate, each.known(candidate), good, starts)
            for interpretation in each.interpretations(candidate, buffer, new)
        )
        first = max(min(opens, default=len(buffer)), len(buffer) - self._longest)
        return counting, Pending(
            buffer[first:],
            tuple(s - first for s in starts if first <= s < len(buffer)),
            tuple(sorted({(max(a - first, -1), b - first) for a, b in good.spans if b > first})),
        )

    def ends_open(self, item: bytes) -> bool:
        """Say whether an item by itself leaves a frame begun that may be more than a read."""
        return bool(self.open_heads(self.interpret(Pending(), item)[1]))

    def open_heads(self, pending: Pending) -> tuple[OpenHead, ...]:
        """Return the frames that what is pending has begun, and that may be more than reads once they are whole."""
        good, found = _Good(pending.good), []
        for at in range(len(pending.tail)):
            for each in self._dialects:
                if each.finder.headless and at not in pending.starts:
                    # Their drives begin to read where a sending begins.
                    continue
                candidates, is_open = each.finder.at(pending.tail, at)
                begun = [(c, m) for c in candidates if c.known and not c.complete for m in each.meanings(c)]
                means = [m for _, m in begun]
                acts = any(not m.risks <= _READ for m in means)
                # What a package does is not known before its slots have come.
                reads = bool(means) and not acts and all(m.command is None or m.command.slots is None for m in means)
                if is_open and not reads:
                    more = any(c.code_at < len(pending.tail) - 1 and not m.risks <= _READ for c, m in begun)
                    found.append(OpenHead(each.dialect, pending.tail[at:], more or not good.has(at)))
        return tuple(found)


class OpenHead(NamedTuple):
    """A frame that was begun. `data`: what there is of it.

    `bare`: it stands in no good frame, or there is more of it than a code that acts. By chance a good frame ends with less.
    """

    dialect: Dialect
    data: bytes
    bare: bool


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

    def out_of_step(self, candidate: Candidate) -> bool:
        """Say whether a candidate begins inside one, goes on beyond its end, and has no byte that belongs to none."""
        at, stop = candidate.start, candidate.stop
        beyond = any(a < at < b and (stop > b or not candidate.complete) for a, b in self.spans)
        return beyond and all(self.has(n) for n in range(at, stop))


def _counts(candidate: Candidate, known: bool, good: _Good, starts: tuple[int, ...]) -> bool:
    explained = good.has(candidate.code_at)
    if candidate.fits:
        return known or not explained or good.holds(candidate.start, candidate.stop)
    if known and not candidate.slot:
        return not (good.begins(candidate.start, candidate.code_at) or good.out_of_step(candidate))
    return not (explained or candidate.weak or (candidate.first_only and candidate.start not in starts))


# --- what data may mean -------------------------------------------------------------------------------------------


class _Meaning(NamedTuple):
    """What a request may tell a drive. `values`: integers as sent, those that are there; `form` None: none fits."""

    command: Command | None
    form: Form | None
    values: dict[str, int]
    risks: frozenset[Risk]


def _worst(command: Command) -> _Meaning:
    return _Meaning(command, None, {}, command.risks({}))


def _meanings(commands: Sequence[Command], data: bytes, size: int | None) -> list[_Meaning]:
    """Return what data of these commands (of one code) may mean.

    `data`: what is there of `size` bytes; None: how many there will be is not known. Whole data mean one thing, the first
    form that fits, as in the catalogue; data that are cut off may mean several; data of no layout the worst of each.
    """
    found = []
    whole = size is not None and len(data) >= size
    for command in commands:
        for form in command.request_forms:
            if whole:
                if codec(form.layout).matches(data):
                    values = codec(form.layout).wire(data)
                    return [_Meaning(command, form, values, command.risks(values))]
            elif size is None or form.layout.byte_length == size:
                known = _partly(form, data)
                if known is not None:
                    found.append(_Meaning(command, form, known, command.risks(known)))
    return found or [_worst(command) for command in commands]


def _partly(form: Form, data: bytes) -> dict[str, int] | None:
    """Return the values of the fields that are there in full; None where a field that makes the layout has another one."""
    layout = form.layout
    have = 8 * len(data)
    whole = codec(layout).wire(data[: layout.byte_length].ljust(layout.byte_length, b"\0"))
    values: dict[str, int] = {}
    for offset, field in layout:
        if field.kind in (FieldKind.RESERVED, FieldKind.BYTES) or offset + field.bit_width > have:
            continue
        value = whole[field.name]
        if field.fixed is not None and value != field.fixed:
            return None
        values[field.name] = value
    return values


# --- CAN ----------------------------------------------------------------------------------------------------------


class CanInterpreter:
    """Interprets what leaves on a CAN bus."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self._dialects = [_of(d) for d in dialects]
        self._kept: dict[tuple[int, bytes, str], tuple[Interpretation, ...]] = _known(*self._dialects)

    def interpret(self, frame: CanFrame) -> tuple[Interpretation, ...]:
        """Return the interpretations of a frame in all dialects."""
        strange = _strangeness(frame)
        key = (frame.id, frame.data, strange)
        known = self._kept.get(key)
        if known is None:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            known = self._kept[key] = tuple(self._interpret(frame, strange))
        return known

    def _interpret(self, frame: CanFrame, strange: str) -> Iterator[Interpretation]:
        beside = UNKNOWN if strange else frozenset[Risk]()
        candidates = [(each, c) for each in self._dialects for c in each.finder.at(frame.data, 0, frame.id).found]
        good = [] if strange else [(each, c) for each, c in candidates if each.good(c)]
        for each, candidate in good or candidates:
            note = strange or ("" if frame.data or candidate.complete else "a frame without data")
            yield from each.interpretations(candidate._replace(note=note), frame.data, 0, beside)


def _strangeness(frame: CanFrame) -> str:
    """Return in words why a frame is not a plain one of 11 bits; nothing where it is."""
    kinds = (
        (frame.error, "an error frame"),
        (frame.fd, "a CAN FD frame"),
        (frame.remote, "a remote frame"),
        (frame.extended or frame.id > _CAN_ID_LIMIT, "an identifier of 29 bits"),
    )
    return next((text for is_so, text in kinds if is_so), "")
