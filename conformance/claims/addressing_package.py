"""Packages: five slots of ten bytes for up to five drives, 52 bytes in all, executed by address and never answered.

    FC | 01 F4 00 3C C8 00 00 01 90 00 | 02 ... | zeros | zeros | zeros | sum

What a slot makes the drive do is a small move, whose length tells which slot was executed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.hearing import ask_first, came, judge_next, plain_read
from conformance.motion import effects, motion
from conformance.motion.effects import STEP, STEP_NS
from conformance.talk.exchange import Exchange, hex_of

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: A slot as the encoder takes it.
Slot = dict[str, Any]
#: A slot of zeros, which is unused.
EMPTY: Slot = {}
#: What tells the move of one slot from that of another, in steps of the witness.
_ONE, _OTHER = 1, 3


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about packages of a dialect that has them."""
    package = next(c for c in dialect.commands if c.slots is not None)
    if Verb.MOVE_RELATIVE_AXIS not in dialect.by_verb or not motion.can_move(dialect) or package.slots is None:
        return
    make = _Maker(dialect, package)
    for number in range(1, package.slots.count + 1):
        yield make.slot(number)
    yield make.among_others()
    yield make.silent()
    yield make.first_of_two()
    yield make.of_others()
    yield make.of_all()
    yield make.of_zeros()
    yield make.following()
    yield make.broken_off()
    yield from make.damaged()


class _Maker:
    """Makes the claims about the packages of a dialect."""

    def __init__(self, dialect: Dialect, package: Command) -> None:
        self.dialect, self.package = dialect, package
        assert package.slots is not None
        self.count, self.size = package.slots.count, package.slots.size

    # --- frames -------------------------------------------------------------------------------------------------------

    def move(self, address: int, steps: int = _ONE) -> Slot:
        """Return a slot that moves a drive by some steps."""
        command = self.dialect.by_verb[Verb.MOVE_RELATIVE_AXIS].name
        return {"address": address, "command": command, "speed": 60, "acceleration": 200, "position": STEP * steps}

    def frame(self, probe: Probe, slots: Sequence[Slot]) -> bytes:
        """Return a package whose slots stand where they stand in `slots`; an empty one is a slot of zeros."""
        data = b"".join(self._data(probe, slot) for slot in slots).ljust(self.count * self.size, b"\0")
        return self.dialect.link.completed(bytes((self.package.code,)) + data)

    def _data(self, probe: Probe, slot: Slot) -> bytes:
        if not slot:
            return bytes(self.size)
        built = probe.build(self.package, {"slots": [slot]}).frame
        return built[1 : 1 + self.size]

    # --- judging ------------------------------------------------------------------------------------------------------

    def moved(self, probe: Probe, frame: bytes) -> tuple[int, Exchange]:
        """Send a package and return by how many steps the shaft has moved then. Raises Inconclusive."""
        before = probe.read(Verb.READ_POSITION, "position")
        sent = probe.send(frame, timeout_ns=STEP_NS * _OTHER)
        after = probe.read(Verb.READ_POSITION, "position")
        return round((after - before) / STEP), sent

    def judge(self, probe: Probe, frame: bytes, steps: int, what: str) -> None:
        """Refute a drive that does not move by so many steps after a package, and prove that it can move."""
        got, sent = self.moved(probe, frame)
        if got != steps:
            if steps:
                self.control(probe)
            raise Refuted(
                f"{what}: the shaft moves by {got * STEP} counts",
                expected=f"{steps * STEP} counts after {hex_of(frame)}",
                got=f"{got * STEP} counts",
                exchange=sent,
                key=what,
            )
        if not steps:
            self.control(probe)

    def control(self, probe: Probe) -> None:
        """Raise Inconclusive where the drive does not move when it is told by itself."""
        shown = effects.chosen(self.dialect)
        if shown is None:
            raise Inconclusive("there is nothing that shows whether the drive executes")
        shown.control(probe)

    def claim(
        self, name: str, statement: str, refuted_by: str, slots: Any, steps: int, *, sure: Certainty = Certainty.CERTAIN
    ) -> Claim:
        """Return a claim that a package moves the drive by so many steps. `slots(own)` returns its slots."""

        def check(probe: Probe) -> None:
            motion.ready_to_move(probe)
            self.judge(probe, self.frame(probe, slots(probe.address)), steps, statement)

        return self.declared(name, statement, refuted_by, check, sure=sure)

    def declared(
        self, name: str, statement: str, refuted_by: str, check: Any, *, sure: Certainty = Certainty.CERTAIN,
        emulated: bool = False, cut: bool = False,
    ) -> Claim:  # fmt: skip
        """Return a claim about packages. `cut`: what is sent can be read with other slots than it was built with."""
        return declare(
            self.dialect,
            Theme.ADDRESSING,
            f"package/{name}",
            statement,
            refuted_by,
            check,
            command=self.package,
            at_best=sure,
            alone=True,
            emulated=emulated,
            risks=motion.risks(self.dialect, *((Risk.UNKNOWN,) if cut else ())),
            settings=motion.settings(self.dialect),
        )

    # --- the claims ---------------------------------------------------------------------------------------------------

    def slot(self, number: int) -> Claim:
        """Return the claim that a command is executed in a slot, with all others unused."""
        statement = f"A command in slot {number} of a package is executed, with the other slots unused."
        return self.claim(f"slot_{number}", statement, "no move", lambda own: [EMPTY] * (number - 1) + [self.move(own)], _ONE)

    def among_others(self) -> Claim:
        """Return the claim that a drive takes its own slot from among those of others."""

        def slots(own: int) -> list[Slot]:
            others = _others(self.dialect, own, self.count - 1)
            return [self.move(others[0], _OTHER), self.move(own), *(self.move(a, _OTHER) for a in others[1:])]

        statement = "Of a package for five drives each executes its own slot."
        return self.claim("own_slot", statement, "no move, or that of another slot", slots, _ONE)

    def first_of_two(self) -> Claim:
        """Return the claim that of two slots for one drive the first is executed."""
        statement = "Of two slots for one drive only the first is executed."
        return self.claim(
            "first_of_two", statement, "the move of the second slot, or of both",
            lambda own: [self.move(own), EMPTY, self.move(own, _OTHER)], _ONE,
        )  # fmt: skip

    def of_others(self) -> Claim:
        """Return the claim that a package for others is nothing to the drive."""
        statement = "A package for other drives is not executed."
        return self.claim(
            "others", statement, "a move", lambda own: [self.move(a) for a in _others(self.dialect, own, self.count)], 0
        )

    def of_all(self) -> Claim:
        """Return the claim that a slot with the address of all drives is not executed."""
        statement = "A slot with the address 0 is not executed: a slot names one drive."
        to = self.dialect.broadcast or 0
        return self.claim("broadcast_slot", statement, "a move", lambda own: [self.move(to)], 0, sure=Certainty.LIKELY)

    def of_zeros(self) -> Claim:
        """Return the claim that a package of zeros does nothing."""
        return self.claim("unused", "A package without a used slot does nothing.", "a move", lambda own: [EMPTY], 0)

    def silent(self) -> Claim:
        """Return the claim that a package is not answered."""
        statement = "A package is not answered, neither when a move begins nor when it is done."

        def check(probe: Probe) -> None:
            motion.ready_to_move(probe)
            read = {"address": probe.address, "command": plain_read(self.dialect).name}
            for slot in (read, self.move(probe.address)):
                frame = self.frame(probe, [slot])
                sent = probe.send(frame, timeout_ns=STEP_NS * _OTHER)
                if not sent.silent:
                    raise Refuted(
                        "a package is answered", expected=f"silence after {hex_of(frame)}", got=came(sent), exchange=sent
                    )

        return self.declared("silent", statement, "any answer", check)

    def following(self) -> Claim:
        """Return the claim that the next request behind a package is answered."""

        def check(probe: Probe) -> None:
            ask_first(probe)
            read = {"address": probe.address, "command": plain_read(self.dialect).name}
            judge_next(probe, "a package", lambda: probe.send(self.frame(probe, [read])))

        statement = "The next request to the drive behind a package is answered."
        return self.declared("next", statement, "silence, or another answer", check)

    def broken_off(self) -> Claim:
        """Return the claim that the next request behind a package that breaks off is answered."""

        def check(probe: Probe) -> None:
            ask_first(probe)
            frame = self.frame(probe, [{"address": probe.address, "command": plain_read(self.dialect).name}])
            for size in (1, 3, self.size, len(frame) // 2, len(frame) - 1):
                judge_next(probe, f"{size} bytes of a package", partial(probe.send, frame[:size]))

        statement = "The next request to the drive behind a package that breaks off is answered, after a pause."
        return self.declared("broken_off", statement, "silence", check, sure=Certainty.LIKELY, cut=True)

    def damaged(self) -> Iterator[Claim]:
        """Yield the claims that a package of another length, or with a wrong sum, is not executed. Emulated drives only."""
        link = self.dialect.link

        def lengths(frame: bytes) -> Iterator[bytes]:
            for size in (1, 10, 20, 40):
                yield link.completed(frame[: -1 - size])
            yield link.completed(frame[:-1] + b"\0")
            yield link.completed(frame[:-1] + bytes(10))

        def sums(frame: bytes) -> Iterator[bytes]:
            for bit in (0, 3, 7):
                yield frame[:-1] + bytes((frame[-1] ^ 1 << bit,))

        kinds = (
            ("length", "A package of more or fewer than 52 bytes is not executed.", lengths),
            ("checksum", "A package whose checksum does not fit is not executed.", sums),
        )
        for name, statement, variants in kinds:

            def check(probe: Probe, variants: Any = variants, statement: str = statement) -> None:
                motion.ready_to_move(probe)
                for frame in variants(self.frame(probe, [self.move(probe.address)])):
                    self.judge(probe, frame, 0, statement)

            yield self.declared(name, statement, "a move", check, emulated=True, cut=True)


def _others(dialect: Dialect, own: int, count: int) -> list[int]:
    first, last = dialect.addresses
    return [a for a in range(max(first, own - count), last + 1) if a != own][:count]
