"""Packages: five slots of ten bytes for up to five drives, 52 bytes in all, executed by address and never answered.

    FC | 01 F4 00 3C C8 00 00 01 90 00 | 02 ... | zeros | zeros | zeros | sum

What a slot makes the drive do is a small move, whose length tells which slot was executed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive, Theme
from conformance.claims.control_reads import ask_first, expect_silence, judge_next, plain_read
from conformance.claims.declare import Case, Cases, claim
from conformance.claims.known_reads import every_read
from conformance.motion import declared, effects, motion
from conformance.motion.declared import CALM, MOVES, QUICK
from conformance.motion.effects import STEP
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe

#: A slot as the encoder takes it; an empty one is a slot of zeros, which is unused.
Slot = dict[str, Any]
#: The slots of a package for a drive, and by how many steps they move it.
Slots = Callable[[Dialect, Command, int], Sequence[Slot]]
EMPTY: Slot = {}
#: What tells the move of one slot from that of another, in steps.
_ONE, _OTHER = 1, 3
#: Three steps take 0.09 s, and as many pulses as a step has counts 0.11 s: a ramp up, and one down.
_STEPS_NS = 160_000_000
#: A value that enabling does not have.
_NO_CHOICE = 2
#: How long a motion and a stop are listened to: their ramps take 104 ms, and a shaft that stopped settles.
_TURNS_NS, _FALLS_NS, _STANDS_NS = 130_000_000, 105_000_000, 200_000_000
#: How far a motion would go (degrees).
_FAR = 10 * 360
#: A speed of two bytes, whose low byte alone is slow.
_RPM = 260


def of(dialect: Dialect) -> list[Command]:
    """Return the command whose data is a package, where its effect can be seen; none where there is none."""
    shown = Verb.MOVE_RELATIVE_AXIS in dialect.by_verb and declared.can_move(dialect)
    return [command for command in dialect.commands if command.slots is not None] if shown else []


def _packages(dialect: Dialect) -> Iterator[Case]:
    return (Case(dialect, command) for command in of(dialect))


def of_packages(
    refuted_by: str, *, name: str, each: Cases = _packages, other_slots: bool = False, **facts: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check that sends packages. `other_slots`: they can be read with other slots than they were built with."""
    more = (Risk.UNKNOWN,) if other_slots else ()
    return claim(
        Theme.ADDRESSING,
        each=each,
        name=f"package/{name}",
        refuted_by=refuted_by,
        alone=True,
        risks=lambda case: declared.risks(case.dialect, *more),
        settings=lambda case: declared.settings(case.dialect),
        parameters={},
        **facts,
    )


# --- packages ---------------------------------------------------------------------------------------------------------


def _move(dialect: Dialect, address: int, steps: int = _ONE) -> Slot:
    """Return a slot that moves a drive by some steps."""
    command = dialect.by_verb[Verb.MOVE_RELATIVE_AXIS].name
    return {"address": address, "command": command, "speed": 120, "acceleration": 248, "position": STEP * steps}


def _read(probe: Probe) -> Slot:
    return {"address": probe.address, "command": plain_read(probe.dialect).name}


def others_of(dialect: Dialect, own: int, count: int) -> list[int]:
    """Return so many addresses of other drives."""
    first, last = dialect.addresses
    return [a for a in range(max(first, own - count), last + 1) if a != own][:count]


def frame_of(probe: Probe, package: Command, slots: Sequence[Slot]) -> bytes:
    """Return a package whose slots stand where they stand in `slots`."""
    assert package.slots is not None
    size = package.slots.size
    parts = [probe.build(package, {"slots": [s]}).frame[1 : 1 + size] if s else bytes(size) for s in slots]
    data = b"".join(parts).ljust(package.slots.count * size, b"\0")
    return probe.dialect.link.completed(bytes((package.code,)) + data)


def _send(probe: Probe, frame: bytes) -> tuple[int, Exchange]:
    """Send a package; return by how many steps the shaft has moved then. Raises Inconclusive."""
    before = probe.read(Verb.READ_POSITION, "position")
    sent = probe.send(frame, timeout_ns=_STEPS_NS)
    return round((probe.read(Verb.READ_POSITION, "position") - before) / STEP), sent


def _expect_move(probe: Probe, frame: bytes, steps: int, what: str) -> None:
    """Expect a move by so many steps after a package, of a drive that moves when it is told by itself."""
    moved, sent = _send(probe, frame)
    shown = effects.observable(probe.dialect)
    if shown is None:
        raise Inconclusive("there is nothing that shows whether the drive executes")
    if (moved == steps) == (steps == 0):
        shown.control(probe)
    probe.expect(
        moved * STEP,
        equal=steps * STEP,
        unit="counts",
        expected=f"{steps * STEP} counts after {hex_of(frame)}",
        refutes=f"{what}: the shaft moves by {moved * STEP} counts",
        exchange=sent,
        key=what,
    )


# --- which slot is executed -------------------------------------------------------------------------------------------


def _in_slot(number: int) -> Slots:
    return lambda dialect, package, own: [EMPTY] * (number - 1) + [_move(dialect, own)]


def _amid_others(dialect: Dialect, package: Command, own: int, slots: Mapping[int, Slot]) -> list[Slot]:
    """Return slots by their numbers, and moves of other drives in all others."""
    assert package.slots is not None
    others = iter(others_of(dialect, own, package.slots.count - len(slots)))
    numbers = range(1, package.slots.count + 1)
    return [slots[n] if n in slots else _move(dialect, next(others), _OTHER) for n in numbers]


def _behind_others(dialect: Dialect, package: Command, own: int) -> list[Slot]:
    assert package.slots is not None
    return _amid_others(dialect, package, own, {package.slots.count: _move(dialect, own)})


def _two_of_one(dialect: Dialect, package: Command, own: int) -> list[Slot]:
    return _amid_others(dialect, package, own, {1: _move(dialect, own), 3: _move(dialect, own, _OTHER)})


def _two_kinds_of_one(dialect: Dialect, package: Command, own: int) -> list[Slot]:
    # The moves differ in length, so the position shows which slots were executed.
    pulses = {"command": Verb.MOVE_RELATIVE_PULSES.value, "direction": 0, "speed": 120, "acceleration": 248, "pulses": STEP}
    return [_move(dialect, own), {"address": own, **pulses}, EMPTY, EMPTY, {"address": own, **pulses}]


def _behind_no_motion(first: Callable[[Dialect], Slot], numbers: tuple[int, int]) -> Slots:
    """Return a slot of something that is no motion, and a move behind it, in slots of these numbers."""

    def slots(dialect: Dialect, package: Command, own: int) -> list[Slot]:
        pair = ({"address": own, **first(dialect)}, _move(dialect, own))
        return _amid_others(dialect, package, own, dict(zip(numbers, pair, strict=True)))

    return slots


def _enabling(value: int) -> Callable[[Dialect], Slot]:
    return lambda dialect: {"command": dialect.by_verb[Verb.ENABLE].name, "enabled": value}


def _for_others(dialect: Dialect, package: Command, own: int) -> list[Slot]:
    assert package.slots is not None
    return [_move(dialect, a) for a in others_of(dialect, own, package.slots.count)]


def _for_all_last(dialect: Dialect, package: Command, own: int) -> list[Slot]:
    assert package.slots is not None
    others = [_move(dialect, a, _OTHER) for a in others_of(dialect, own, package.slots.count - 1)]
    return [*others, _move(dialect, dialect.broadcast or 0)]


def _unused(dialect: Dialect, package: Command, own: int) -> list[Slot]:
    return [EMPTY]


#: Name, slots, steps, statement, what refutes it, how sure.
_ROWS: tuple[tuple[str, Slots, int, str, str, Certainty], ...] = (
    (
        "own_slot",
        lambda dialect, package, own: _amid_others(dialect, package, own, {2: _move(dialect, own)}),
        _ONE,
        "Of a package for five drives each executes its own slot.",
        "no move, or that of another slot",
        Certainty.CERTAIN,
    ),
    (
        "last_of_five",
        _behind_others,
        _ONE,
        "A drive executes its own slot behind those of four others.",
        "no move, or that of another slot",
        Certainty.CERTAIN,
    ),
    (
        "first_of_two",
        _two_of_one,
        _ONE,
        "Of two slots for one drive only the first is executed.",
        "the move of the second slot, or of both",
        Certainty.CERTAIN,
    ),
    (
        "first_of_kinds",
        _two_kinds_of_one,
        _ONE,
        "Of slots for one drive with different commands only the first is executed.",
        "the effect of another slot, or of all",
        Certainty.CERTAIN,
    ),
    *(
        (
            f"behind_{kind}",
            _behind_no_motion(first, numbers),
            0,
            f"Of two slots for one drive only the first is executed, where that is {what} and the second a move too.",
            "a move",
            Certainty.CERTAIN,
        )
        for kind, what, first, numbers in (
            ("read", "a read", lambda dialect: {"command": plain_read(dialect).name}, (4, 5)),
            ("setting", "a setting", _enabling(1), (2, 4)),
            ("refused", "a command that is refused", _enabling(_NO_CHOICE), (1, 5)),
        )
    ),
    ("others", _for_others, 0, "A package for other drives is not executed.", "a move", Certainty.CERTAIN),
    (
        "broadcast_slot",
        lambda dialect, package, own: [_move(dialect, dialect.broadcast or 0)],
        0,
        "A slot with the address 0 is not executed: a slot names one drive.",
        "a move",
        Certainty.LIKELY,
    ),
    (
        "broadcast_last",
        _for_all_last,
        0,
        "A slot with the address 0 behind those of other drives is not executed.",
        "a move",
        Certainty.LIKELY,
    ),
    ("unused", _unused, 0, "A package without a used slot does nothing.", "a move", Certainty.CERTAIN),
)


def _slots(dialect: Dialect) -> Iterator[Case]:
    for case in _packages(dialect):
        assert case.command is not None
        assert case.command.slots is not None
        for number in range(1, case.command.slots.count + 1):
            statement = f"A command in slot {number} of a package is executed, with the other slots unused."
            facts: dict[str, Any] = {"statement": statement, "refuted_by": "no move", "at_best": Certainty.CERTAIN}
            given = {"kind": f"slot_{number}", "slots": _in_slot(number), "steps": _ONE}
            yield Case(dialect, case.command, given, facts)
        for kind, slots, steps, statement, refuted_by, at_best in _ROWS:
            # A value that enabling does not have is unknown.
            more = (Risk.UNKNOWN,) if kind == "behind_refused" else ()
            risks = declared.risks(dialect, *dialect.by_verb[Verb.ENABLE].all_risks, *more)
            facts = {"statement": statement, "refuted_by": refuted_by, "at_best": at_best, "risks": risks}
            yield Case(dialect, case.command, {"kind": kind, "slots": slots, "steps": steps}, facts)


@of_packages("", name="{kind}", each=_slots)
def _executed(probe: Probe, command: Command, slots: Slots, steps: int) -> None:
    motion.ready_to_move(probe)
    frame = frame_of(probe, command, slots(probe.dialect, command, probe.address))
    _expect_move(probe, frame, steps, probe.claim.statement)


def in_own_slot(probe: Probe, command: Command, values: Mapping[str, int]) -> bytes:
    """Return a package with a command to the drive, behind reads of other drives.

    The code of the command chooses the slot, so that settings stand in each of them.
    """
    (package,) = of(probe.dialect)
    assert package.slots is not None
    others = others_of(probe.dialect, probe.address, command.code % package.slots.count)
    slots = [{**_read(probe), "address": address} for address in others]
    return frame_of(probe, package, [*slots, {"address": probe.address, "command": command.name, **values}])


def motions(dialect: Dialect) -> Iterator[Case]:
    """Yield the package with each motion, its stops and a slot for all of them."""
    for case in _packages(dialect):
        assert case.command is not None
        assert case.command.slots is not None
        for number, run in enumerate(dialect.motions(MotionKind.RUN, *MOVES)):
            slot = 1 + number % case.command.slots.count
            given = {"run": run, "stops": dialect.stops_of(run), "before": slot - 1}
            yield Case(dialect, case.command, given, {"risks": declared.risks(dialect, *run.all_risks)})


@of_packages("a shaft that stands, or one that turns on", name="{run}", each=motions)
def _turns_and_stops(probe: Probe, command: Command, run: Command, stops: Sequence[Command], before: int) -> None:
    """{run} in a slot of a package turns the shaft either way, and each of its stops in it lets it stand."""
    motion.prepare(probe, run)
    one, other = (_run_and_stop(probe, command, run, stop, before, way) for stop, way in zip(_two(stops), (1, -1), strict=True))
    text = f"{run.name} in a slot of a package turns the shaft one way for both directions"
    got = f"{one:+g} and {other:+g} rpm"
    probe.expect(got, holds=one * other < 0, expected="one way, then the other", refutes=text)


def _two(stops: Sequence[Command]) -> tuple[Command, Command]:
    """Return the first of some stops and the last, which may be one."""
    return stops[0], stops[-1]


def rpm_of(run: Command, way: int) -> float:
    """Return how fast a run or move turns in a package; of a run the sign is its way."""
    return way * _RPM if declared.of(run).kind is MotionKind.RUN else _RPM


def _run_and_stop(probe: Probe, command: Command, run: Command, stop: Command, before: int, way: int) -> float:
    """Run and stop by packages; return the speed in between."""
    start = motion.place(probe, run)
    values = declared.values_of(probe.dialect, run, way * _FAR, rpm=rpm_of(run, way), start=start)
    seen = []
    ending = {"acceleration": QUICK} if declared.of(stop).acceleration else {}
    for order, data, time_ns in ((run, values, _TURNS_NS), (stop, ending, _FALLS_NS)):
        slot = {"address": probe.address, "command": order.name, **data}
        sent = probe.send(frame_of(probe, command, [EMPTY] * before + [slot]), timeout_ns=time_ns)
        if order is stop:
            with contextlib.suppress(Inconclusive):
                motion.wait_standing(probe, limit_ns=_STANDS_NS - _FALLS_NS)
        seen.append((motion.turning(probe).value, sent))
    (rpm, begun), (rest, ended) = seen
    turning, left = abs(rpm), abs(rest)
    text = f"{run.name} in a slot of a package does not turn the shaft"
    probe.expect(turning, at_least=CALM / 2, unit="rpm", refutes=text, exchange=begun)
    if left:
        motion.stop(probe)
    text = f"{stop.name} in a slot of a package does not stop the shaft"
    probe.expect(left, at_most=1, unit="rpm", refutes=text, exchange=ended)
    return rpm


# --- what is answered -------------------------------------------------------------------------------------------------


def _switching(dialect: Dialect) -> Iterator[Case]:
    for case in _packages(dialect):
        yield Case(dialect, case.command, facts={"risks": declared.risks(dialect, *dialect.by_verb[Verb.ENABLE].all_risks)})


@of_packages("any answer", name="silent", each=_switching)
def _silent(probe: Probe, command: Command) -> None:
    """A package is not answered: no read, no setting, no refused move, and no move, when it begins or when it is done."""
    motion.ready_to_move(probe)
    assert command.slots is not None
    own = probe.address
    inner = [{"command": read.name, **values} for read, values in every_read(probe.dialect)]
    inner += [{"command": probe.command(Verb.ENABLE).name, "enabled": enabled} for enabled in (0, 1)]
    # Before the motor is on again a move is refused; each slot has something to say.
    refused = _move(probe.dialect, own)
    slots = [*inner[:-1], refused, inner[-1], refused]
    for number, slot in enumerate(slots):
        frame = frame_of(probe, command, [EMPTY] * (number % command.slots.count) + [{"address": own, **slot}])
        sent = probe.send(frame, timeout_ns=_STEPS_NS if slot is refused else probe.rig.silence_ns)
        expect_silence(probe, sent, "a package is answered")


@of_packages("silence, or another answer", name="next")
def _behind(probe: Probe, command: Command) -> None:
    """The next request to the drive behind a package is answered."""
    ask_first(probe)
    judge_next(probe, "a package", lambda: probe.send(frame_of(probe, command, [_read(probe)])))


@of_packages("silence", name="broken_off", at_best=Certainty.LIKELY, other_slots=True)
def _broken_off(probe: Probe, command: Command) -> None:
    """The next request to the drive behind a package that breaks off is answered, after a pause."""
    assert command.slots is not None
    ask_first(probe)
    frame = frame_of(probe, command, [_read(probe)])
    for size in (1, 3, command.slots.size, len(frame) // 2, len(frame) - 1):
        judge_next(probe, f"{size} bytes of a package", partial(probe.send, frame[:size]))


# --- damaged packages: emulated drives alone --------------------------------------------------------------------------


def _expect_nothing(probe: Probe, command: Command, damaged: Callable[[bytes], Iterator[bytes]]) -> None:
    motion.ready_to_move(probe)
    for frame in damaged(frame_of(probe, command, [_move(probe.dialect, probe.address)])):
        _expect_move(probe, frame, 0, probe.claim.statement)


@of_packages("a move", name="length", emulated=True, other_slots=True)
def _other_lengths(probe: Probe, command: Command) -> None:
    """A package of more or fewer than 52 bytes is not executed."""
    completed = probe.dialect.link.completed

    def lengths(frame: bytes) -> Iterator[bytes]:
        for size in (1, 10, 20, 40):
            yield completed(frame[: -1 - size])
        # What ends in a sound package would be a package and more bytes.
        more = b"\0" if frame[-1] else b"\1"
        yield completed(frame[:-1] + more)
        yield completed(frame[:-1] + more * 10)

    _expect_nothing(probe, command, lengths)


@of_packages("a move", name="damaged", other_slots=True)
def _damaged(probe: Probe, command: Command) -> None:
    """A package with one bit of its checksum flipped moves nothing, and one whose checksum fits does."""
    _expect_nothing(probe, command, lambda frame: (frame[:-1] + bytes((frame[-1] ^ 1 << bit,)) for bit in (1, 6)))


@of_packages("a move", name="checksum", emulated=True, other_slots=True)
def _wrong_sums(probe: Probe, command: Command) -> None:
    """A package whose checksum does not fit is not executed."""
    _expect_nothing(probe, command, lambda frame: (frame[:-1] + bytes((frame[-1] ^ 1 << bit,)) for bit in (0, 3, 7)))
