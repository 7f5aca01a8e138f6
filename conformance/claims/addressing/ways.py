"""Ways to several drives: all of them (broadcast), a group, and packages; what a claim needs that sends so.

many.join(probe)                       the drive hears it; its address
many.frame(probe, command, values, to) a command that goes so
addressing("any answer", cases)        declares a check; risks and settings of the way are named for it
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from analyzer.catalogue import Command, Dialect, Doubt, Risk, Subject, Verb
from conformance.claim import Theme
from conformance.claims.addressing import package
from conformance.claims.control_reads import plain_read
from conformance.claims.declare import Case, Cases, claim, described_in
from conformance.gate.gate import Item
from conformance.motion.effects import Change
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: A group address, and another one where the drive itself has it; the bits of a byte.
_GROUP, _OTHER_GROUP, BYTE = 0x50, 0x60, 0xFF
_HIGH_GROUP = 0xE0


def send_to(probe: Probe, address: int, change: Change, listen_ns: int = 0) -> Exchange:
    """Send a change to an address and return what came back while it could have been executed."""
    built = probe.build(change.command, change.values, address=address)
    return probe.send(built.item(), timeout_ns=max(listen_ns, probe.rig.silence_ns))


def read_of(probe: Probe, address: int) -> Exchange:
    """Send a good read to an address and return what came back within the time of a silence."""
    return probe.send(probe.build(plain_read(probe.dialect), address=address).item())


def _addressed(probe: Probe, command: Command, values: Mapping[str, int], to: int) -> Item | bytes:
    return probe.build(command, values, address=to).item()


@dataclass(frozen=True)
class Many:
    """A way to several drives. `join`: makes the drive hear it and returns its address; `frame`: a command that goes so.

    The rest is what a claim declares.
    """

    name: str
    what: str
    join: Callable[[Probe], int]
    section: Callable[[Case], str]
    settings: tuple[str, ...] = ()
    rests_on: tuple[Doubt, ...] = ()
    setting: Verb | None = None
    frame: Callable[[Probe, Command, Mapping[str, int], int], Item | bytes] = _addressed

    def risks(self, dialect: Dialect) -> frozenset[Risk]:
        return frozenset() if self.setting is None else dialect.by_verb[self.setting].all_risks


def _all_drives(probe: Probe) -> int:
    assert probe.dialect.broadcast is not None  # asked by `addresses`
    return probe.dialect.broadcast


def group_of(dialect: Dialect, own: int) -> int:
    """Return a group address that is not a drive's own or near it: its neighbours are sent to as well.

    Where an address has more than a byte, one of more than a byte.
    """
    high = 0x100 if dialect.addresses[1] > BYTE else 0
    return high | (_OTHER_GROUP if own & BYTE in range(_GROUP - 2, _GROUP + 3) else _GROUP)


def join(probe: Probe) -> int:
    """Put the drive into a group and return its address."""
    group = group_of(probe.dialect, probe.address)
    probe.do(Verb.SET_GROUP_ADDRESS, {"group_address": group})
    return group


def _join_high(probe: Probe) -> int:
    last = probe.dialect.addresses[1]
    # A byte's highest values begin frames. Of identifiers the highest is like any other.
    group = _HIGH_GROUP if last <= BYTE else last - (probe.address == last)
    probe.do(Verb.SET_GROUP_ADDRESS, {"group_address": group})
    return group


def _address_section(case: Case) -> str:
    command = case.dialect.by_verb.get(Verb.SET_ADDRESS)
    return described_in(Subject.ADDRESSING)(case) if command is None else command.section


BROADCAST = Many("broadcast", "a broadcast", _all_drives, _address_section)
GROUPS = Many(
    "group",
    "a group address",
    join,
    lambda case: case.dialect.by_verb[Verb.SET_GROUP_ADDRESS].section,
    ("group_address",),
    (Doubt.ADDRESSING,),
    Verb.SET_GROUP_ADDRESS,
)


PACKAGES = Many(
    "package",
    "a slot of a package",
    lambda probe: probe.address,
    lambda case: package.of(case.dialect)[0].section,
    frame=lambda probe, command, values, to: package.in_own_slot(probe, command, values),
)


HIGH_GROUPS = replace(GROUPS, name="group/high", what="a high group address", join=_join_high)


def addresses(dialect: Dialect) -> Iterator[Many]:
    """Yield the addresses of several drives that a dialect has."""
    if dialect.broadcast is not None:
        yield BROADCAST
    if Verb.SET_GROUP_ADDRESS in dialect.by_verb:
        yield GROUPS


def ways(dialect: Dialect) -> Iterator[Many]:
    """Yield the ways to several drives that a dialect has."""
    yield from addresses(dialect)
    if package.of(dialect):
        yield PACKAGES


def addressing(refuted_by: str, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check that sends to several drives; what that needs is named for it."""

    def risks(case: Case) -> frozenset[Risk]:
        many: Many = case["many"]
        return many.risks(case.dialect) | (case["shown"].risks if "shown" in case.given else frozenset())

    def settings(case: Case) -> tuple[str, ...]:
        return (*(case["shown"].settings if "shown" in case.given else ()), *case["many"].settings)

    return claim(
        Theme.ADDRESSING,
        each=each,
        refuted_by=refuted_by,
        section=lambda case: case["many"].section(case),
        rests_on=lambda case: case["many"].rests_on,
        risks=risks,
        settings=settings,
        alone=True,
        parameters={},
        **facts,
    )
