"""A request that a user sends by himself: what it is judged by, and why it may not leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, Risk
from analyzer.errors import UsageError
from conformance.gate.gate import Allowance, Item, Judge, Refused, shown


class Request:
    """A request, as it will leave. `addresses` None: any; `dialect` and `command` None: bytes as they are."""

    def __init__(
        self,
        item: Item,
        dialects: Sequence[Dialect],
        addresses: frozenset[int] | None,
        command: Command | None = None,
        address: int | None = None,
    ) -> None:
        self.item = item
        self.dialects = tuple(dialects)
        self.addresses = addresses
        self.command = command
        self.address = address
        self.dialect = self.dialects[0] if command is not None else None
        judge = Judge(Allowance(), registry.every())
        readings = judge.interpret(item)
        #: Whether anything but a read can be meant.
        self.acts = any(not r.reads_only for r in readings)
        #: What the next sending could complete.
        self.left_open = judge.left_open(item)
        #: Bytes of no frame: they could complete what another program has begun.
        self.loose = (
            bytes(b for n, b in enumerate(item) if not any(r.covers(n) for r in readings)) if isinstance(item, bytes) else b""
        )
        #: The drives that it is for.
        self.meant = [(r.dialect, r.address) for r in readings if r.fits and not r.to_many and r.address is not None]
        many = self.dialect is not None and address == self.dialect.broadcast
        self.answered = command is None or (bool(command.reply_forms) and not many and command.slots is None)

    def allowance(self, given: Allowance) -> Allowance:
        """Return what may be sent: a stop that is named needs no permission."""
        stopping = replace(given, risks=given.risks | {Risk.MOTION})
        return stopping if Judge(stopping).is_stop(self.item) else given

    def check(self, allowance: Allowance, dialects: Sequence[Dialect]) -> None:
        """Raise Refused for risks that are not allowed, UsageError for bytes that do not stand alone."""
        found = Judge(replace(allowance, turns=None, speed=None), dialects).objections(self.item)
        if found:
            raise Refused(self.item, found)
        beside = self.beside(allowance)
        if beside:
            raise UsageError(f"not sent: {shown(self.item)}: {beside}")

    def beside(self, allowance: Allowance) -> str:
        """Return what makes an item part of what was sent before or will be, or nothing."""
        begun = [head for head in self.left_open if head.bare or not self.meant]
        if begun:
            text = f"it ends in {shown(begun[0].data)}, the beginning of a frame of {begun[0].dialect.name}"
            return f"{text} that the next sending could complete"
        if self.loose and Risk.UNKNOWN not in allowance.risks:
            return f"{shown(self.loose)} is no frame, and could complete one that another program has begun (--allow unknown)"
        return ""
