"""A twin: the ideal emulated drive of a dialect and model, given the same requests at the same times as the drive under test.

    twin = Twin(dialect, address, model)
    told = twin.hear(item, t_ns)         what it answers to a request: commands, values, bytes
    told = twin.wait(t_ns)               what it says unasked until then
    twin.settle()                        until its shaft stands

The emulated drives know the manual, so that what a twin answers is what the manual says after all that was sent before.

Rules kept here:
- A twin does no I/O. Its clock goes on only by the times that it is given.
- What was done to it is kept, so that drives with a known quirk can live through the same (`with_quirks`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from analyzer.catalogue import Command, Dialect, Role
from analyzer.records import CanFrame, Frame
from conformance.drives import make
from conformance.drives.drive import Drive, Outgoing, Quirk, Values

#: How long a shaft may take to come to rest.
_REST_NS = 60_000_000_000
_PORT = "twin"


class Told(NamedTuple):
    """One reply. `values`: as the drive means them, integers as sent; empty where no behaviour answered."""

    command: Command
    values: Mapping[str, Any]
    data: bytes


class _Ear:
    """One drive, and what it says."""

    def __init__(self, specification: make.Specification) -> None:
        self.drive: Drive = make.make(specification)
        self._told: list[Told] = []
        self._values: Values | None = None
        self.drive.hooks.result.append(self._note)
        self.drive.hooks.reply.append(self._keep)

    def _note(self, drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        self._values = values
        return values

    def _keep(self, drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        self._told.append(Told(command, self._values or {}, outgoing.data))
        self._values = None
        return (outgoing,)

    def taken(self) -> list[Told]:
        told, self._told = self._told, []
        return told

    def hear(self, frame: Frame, t_ns: int) -> list[Told]:
        t_ns = max(t_ns, self.drive.now_ns)
        self.drive.advance(t_ns)
        self.drive.receive(frame, t_ns)
        return self.taken()

    def wait(self, t_ns: int) -> list[Told]:
        if t_ns > self.drive.now_ns:
            self.drive.advance(t_ns)
        return self.taken()


class Twin:
    """The ideal drive. Look at it through `drive`, and change it through `change`."""

    def __init__(self, dialect: Dialect, address: int, model: str = "", quirks: Iterable[Quirk] = ()) -> None:
        self._made = (dialect, address, model, tuple(quirks))
        self._ear = _Ear(make.Specification(*self._made))
        self.drive = self._ear.drive
        self._done: list[Callable[[Twin], object]] = []

    # --- what happens to it -------------------------------------------------------------------------------------------

    def hear(self, item: bytes | CanFrame, t_ns: int) -> list[Told]:
        """Take a request that was complete at a time; return what it answers at once, and what it said until then."""
        self._done.append(lambda twin: twin._hear(item, t_ns))
        return self._hear(item, t_ns)

    def _hear(self, item: bytes | CanFrame, t_ns: int) -> list[Told]:
        can = item if isinstance(item, CanFrame) else None
        data = can.data if can is not None else item
        dialect = self.drive.dialect
        assert isinstance(data, bytes)
        good = all(check.ok for check in dialect.link.checks(data, None if can is None else can.id))
        return self._ear.hear(Frame(_PORT, t_ns, t_ns, 0, data, dialect, Role.REQUEST, good, can), t_ns)

    def wait(self, t_ns: int) -> list[Told]:
        """Let time pass; return what it says unasked."""
        self._done.append(lambda twin: twin._ear.wait(t_ns))
        return self._ear.wait(t_ns)

    def settle(self) -> list[Told]:
        """Let time pass until the shaft stands, and nothing else is under way; return what it says."""
        self._done.append(Twin._settle)
        return self._settle()

    def _settle(self) -> list[Told]:
        drive, until_ns = self.drive, self.now_ns + _REST_NS
        while (due_ns := drive.next_ns()) is not None and due_ns <= until_ns:
            drive.advance(max(due_ns, drive.now_ns))
        if not self.turning:
            drive.advance(max(drive.now_ns, int(drive.rest.at_ns) + 1))
        return self._ear.taken()

    def change(self, what: Callable[[Drive], object]) -> None:
        """Change something in the drive."""

        def act(twin: Twin) -> None:
            what(twin.drive)
            twin.drive.changed()

        self._done.append(act)
        act(self)

    # --- what it is ---------------------------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """Its time."""
        return self.drive.now_ns

    @property
    def turning(self) -> bool:
        """Whether its shaft turns."""
        return self.drive.rest.since_ns < 0

    def with_quirks(self) -> Iterator[Twin]:
        """Yield drives that lived through the same and have a known quirk more."""
        dialect, address, model, quirks = self._made
        for quirk in make.every_quirk():
            if dialect.name in quirk.dialects and quirk not in quirks:
                other = Twin(dialect, address, model, (*quirks, quirk))
                for act in self._done[:-1]:
                    act(other)
                yield other
