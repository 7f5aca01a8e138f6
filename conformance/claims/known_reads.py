"""Reads that a drive answers whatever it is doing: without data, and of any model."""

from __future__ import annotations

from analyzer.catalogue import Command, Dialect, Risk


def plain_reads(dialect: Dialect) -> list[Command]:
    """Return the reads of a dialect that need no data, in the manual's order."""
    reads = (c for c in dialect.commands if c.all_risks == {Risk.READ} and c.slots is None)
    fit = (c for c in reads if c.reply_forms and not c.request_forms[0].layout.fields)
    return [c for c in fit if dialect.model or not c.models]
