"""Error flags of LK motors: that each is shown where it belongs, and what 9B does with them.

A flag needs a cause, which only an emulated drive can be given.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Command, Dialect
from analyzer.protocols.lk_rs485 import ERROR_BITS
from conformance.claim import Claim
from conformance.claims.motion_claim import motion_claim, refute
from conformance.claims.world import lk_drive
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about error flags."""
    state, clear = dialect.by_name["read_state_1"], dialect.by_name["clear_errors"]
    for field in ERROR_BITS:
        yield motion_claim(
            dialect, state, f"flag-{field.name}", f"Where {field.name} is the matter, its flag is set, and no other.",
            "another flag, or none", partial(_flag, field.name), emulated=True, risks=clear.all_risks, still=True,
        )  # fmt: skip
    yield motion_claim(
        dialect,
        clear,
        "clears",
        "9B clears a flag whose cause is gone.",
        "a flag that stays",
        _clears,
        emulated=True,
        still=True,
    )
    yield motion_claim(
        dialect,
        clear,
        "keeps",
        "9B leaves a flag whose cause lasts.",
        "a flag that is cleared",
        _keeps,
        emulated=True,
        still=True,
    )


def _flags(probe: Probe, what: str = "read_state_1") -> tuple[set[str], Exchange]:
    exchange = probe.ask(what)
    values = probe.reply(exchange).values
    return {f.name for f in ERROR_BITS if values.get(f.name)}, exchange


def _expect_flags(probe: Probe, wanted: set[str], when: str) -> None:
    seen, exchange = _flags(probe)
    if seen != wanted:
        names = [", ".join(sorted(each)) or "none" for each in (wanted, seen)]
        raise refute(exchange, f"the error flags {when} are others", expected=names[0], got=names[1])


def _flag(name: str, probe: Probe, command: Command) -> None:
    drive = lk_drive(probe)
    _expect_flags(probe, set(), "at first")
    drive.trip(name)
    _expect_flags(probe, {name}, f"with {name}")
    drive.trip(name, False)
    probe.do("clear_errors")
    _expect_flags(probe, set(), f"after {name} was cleared")


def _clears(probe: Probe, command: Command) -> None:
    drive = lk_drive(probe)
    drive.trip("overcurrent")
    drive.trip("overcurrent", False)
    _expect_flags(probe, {"overcurrent"}, "before 9B")
    probe.do(command)
    _expect_flags(probe, set(), "after 9B, the cause being gone,")


def _keeps(probe: Probe, command: Command) -> None:
    drive = lk_drive(probe)
    drive.trip("motor_hot")
    probe.do(command)
    _expect_flags(probe, {"motor_hot"}, "after 9B, the cause lasting,")
