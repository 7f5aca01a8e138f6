"""Addresses of several drives: all of them (broadcast), and a group. Executed, never answered.

FA 00 F4 ..    every drive moves, none answers
FA 50 F4 ..    every drive of the group 50h moves, none answers; each still answers its own address
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Doubt, Risk, Verb
from conformance.claim import Claim, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.hearing import ask_first, came, is_answered, judge_next, plain_read, section
from conformance.motion import effects
from conformance.motion.effects import Order, Witness
from conformance.talk.exchange import Exchange, hex_of

if TYPE_CHECKING:
    from conformance.talk.probe import Probe


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about broadcasts and groups of a dialect that has them."""
    shown = effects.chosen(dialect)
    if dialect.broadcast is not None:
        yield from _broadcast(dialect, shown)
    if Verb.SET_GROUP_ADDRESS in dialect.by_verb:
        yield from _group(dialect, shown)


def send_to(probe: Probe, address: int, order: Order, listen_ns: int = 0) -> Exchange:
    """Send an order of a witness to an address and return what came back while it could have been executed."""
    built = probe.build(order.command, order.values, address=address)
    return probe.send(built.item(), timeout_ns=max(listen_ns, probe.rig.silence_ns))


def read_of(probe: Probe, address: int) -> Exchange:
    """Send a good read to an address and return what came back within the time of a silence."""
    return probe.send(probe.build(plain_read(probe.dialect), address=address).item())


# --- all drives -------------------------------------------------------------------------------------------------------


def _broadcast(dialect: Dialect, shown: Witness | None) -> Iterator[Claim]:
    where = dialect.by_verb[Verb.SET_ADDRESS].section if Verb.SET_ADDRESS in dialect.by_verb else section(dialect)
    to = dialect.broadcast
    assert to is not None  # asked by `claims`

    def reads(probe: Probe) -> None:
        ask_first(probe)
        for command in _samples(dialect):
            built = probe.build(command, address=to)
            sent = probe.send(built.item())
            if not sent.silent:
                raise _answered_many(sent, "a broadcast")

    def following(probe: Probe) -> None:
        ask_first(probe)
        judge_next(probe, "a broadcast", lambda: read_of(probe, to))

    yield declare(
        dialect, Theme.ADDRESSING, "broadcast/read", "A read by broadcast is not answered.", "any answer", reads,
        section=where, alone=True,
    )  # fmt: skip
    yield declare(
        dialect, Theme.ADDRESSING, "broadcast/next", "The next request to the drive behind a broadcast is answered.",
        "silence, or another answer", following, section=where, alone=True,
    )  # fmt: skip
    if shown is not None:
        yield from _to_many(dialect, "broadcast", "a broadcast", where, shown, lambda probe: to, ())
    zero = effects.setting(dialect)
    if zero is not None:
        yield from _to_many(dialect, "broadcast/setting", "a broadcast", where, zero, lambda probe: to, ())


def _samples(dialect: Dialect) -> list[Command]:
    return [c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.fields][:4]


def _answered_many(sent: Exchange, what: str) -> Refuted:
    return Refuted(
        f"{what} is answered",
        expected=f"silence after {hex_of(sent.sent or b'')}",
        got=came(sent),
        exchange=sent,
        key=f"{what} is answered",
    )


def _to_many(
    dialect: Dialect,
    name: str,
    what: str,
    where: str,
    shown: Witness,
    join: Callable[[Probe], int],
    rests_on: Sequence[Doubt],
    more: Iterable[Risk] = (),
    changed: tuple[str, ...] = (),
) -> Iterator[Claim]:
    """Make the claims that an address of several drives is executed and not answered. `join` makes the drive hear it."""

    def executed(probe: Probe) -> None:
        shown.prepare(probe)
        to = join(probe)
        order = shown.order(probe)
        sent = send_to(probe, to, order, shown.settle_ns)
        if shown.done(probe, order):
            return
        shown.control(probe)
        raise Refuted(
            f"{order.command.name} by {what} is not executed",
            expected=f"{order.after} to be read after {hex_of(sent.sent or b'')}",
            got=f"{order.before} is read",
            exchange=sent,
            key=f"{what} is not executed",
        )

    def silent(probe: Probe) -> None:
        shown.prepare(probe)
        to = join(probe)
        sent = send_to(probe, to, shown.order(probe), shown.settle_ns)
        if not sent.silent:
            raise _answered_many(sent, what)

    demands: dict[str, Any] = {
        "alone": True,
        "risks": {*shown.risks, *more},
        "settings": (*shown.settings, *changed),
        "rests_on": rests_on,
        "section": where,
    }
    statement = f"A command by {what} is executed."
    yield declare(dialect, Theme.ADDRESSING, f"{name}/executed", statement, "no effect of it", executed, **demands)
    statement = f"A command by {what} is not answered, neither when it begins nor when it is done."
    yield declare(dialect, Theme.ADDRESSING, f"{name}/silent", statement, "any answer", silent, **demands)


# --- the group --------------------------------------------------------------------------------------------------------

#: A group address, and another one where the drive itself has it.
_GROUP, _OTHER_GROUP = 0x50, 0x60
_RESTS_ON = (Doubt.ADDRESSING,)


def group_of(own: int) -> int:
    """Return a group address that is not a drive's own or near it: its neighbours are sent to as well."""
    return _OTHER_GROUP if own in range(_GROUP - 2, _GROUP + 3) else _GROUP


def _join(probe: Probe) -> int:
    group = group_of(probe.address)
    probe.do(Verb.SET_GROUP_ADDRESS, {"group_address": group})
    return group


def _group(dialect: Dialect, shown: Witness | None) -> Iterator[Claim]:
    command = dialect.by_verb[Verb.SET_GROUP_ADDRESS]
    where, more, changed = command.section, command.all_risks, ("group_address",)
    demands: dict[str, Any] = {"section": where, "alone": True, "risks": more, "settings": changed, "rests_on": _RESTS_ON}

    def read(probe: Probe) -> None:
        ask_first(probe)
        sent = read_of(probe, _join(probe))
        if not sent.silent:
            raise _answered_many(sent, "a group address")

    def own(probe: Probe) -> None:
        ask_first(probe)
        _join(probe)
        tries = [probe.ask(plain_read(dialect)) for _ in range(2)]
        exchange = tries[-1]
        if not any(is_answered(each) for each in tries):
            raise Refuted(
                "a drive in a group no longer answers its own address",
                expected=f"a reply to {hex_of(exchange.sent or b'')}",
                got=came(exchange),
                exchange=exchange,
            )

    yield declare(
        dialect, Theme.ADDRESSING, "group/read", "A read to the group address is not answered.", "any answer", read,
        **demands,
    )  # fmt: skip
    yield declare(
        dialect, Theme.ADDRESSING, "group/own", "A drive in a group still answers its own address.",
        "silence, or another answer", own, **demands,
    )  # fmt: skip
    if shown is not None:
        yield from _to_many(dialect, "group", "a group address", where, shown, _join, _RESTS_ON, more, changed)
        zero = effects.setting(dialect)
        if zero is not None:
            yield from _to_many(dialect, "group/setting", "a group address", where, zero, _join, _RESTS_ON, more, changed)
        yield _other_group(dialect, shown, demands)


def _other_group(dialect: Dialect, shown: Witness, demands: dict[str, Any]) -> Claim:
    def check(probe: Probe) -> None:
        shown.prepare(probe)
        group = _join(probe)
        order = shown.order(probe)
        for address in (group + 1, group - 1):
            sent = send_to(probe, address, order, shown.settle_ns)
            if not sent.silent or shown.done(probe, order):
                raise Refuted(
                    f"the group {address} is heard, and the drive is in {group}",
                    expected=f"no answer and no effect of {hex_of(sent.sent or b'')}",
                    got=came(sent) if not sent.silent else "it is executed",
                    exchange=sent,
                    key="another group is heard",
                )
        shown.control(probe)

    return declare(
        dialect,
        Theme.ADDRESSING,
        "group/other",
        "A command to another group address than the drive's is neither executed nor answered.",
        "an answer, or an effect of it",
        check,
        **(demands | {"risks": {*demands["risks"], *shown.risks}, "settings": (*demands["settings"], *shown.settings)}),
    )
