"""How a drive took a request: done, refused, or not answered. For claims about which values it takes.

    accept(probe, command, values, "current")     refutes where the drive refuses
    refuse(probe, command, values, "current")     refutes where the drive does it all the same

What a refusal is stands in the catalogue: a status that failed, or a form of the reply (Modbus: FFFFh, a quantity of 0).

Rules kept here:
- An answer that cannot be read, or whose status is in no list, is another claim's matter: Inconclusive.
- Silence counts only where the drive answers a read before and behind it, and the request is not answered when it is sent
  again: a line that loses a reply now and then is not a drive that ignores a value.
- A refusal by an exception is one, but not the one that the manual has: another claim is about that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Form, Risk, Role
from analyzer.encoder import Built
from conformance.claim import Claim, Inconclusive, Refuted
from conformance.model.limits import with_bits
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe


class Taken(Enum):
    """How a drive took a request."""

    DONE = "done"
    REFUSED = "refused"
    SILENT = "not answered"


def refusable(command: Command) -> bool:
    """Say whether a reply of a command can say that it was refused."""
    return bool(command.replies.failed or command.replies.failed_forms)


def plain_read(dialect: Dialect) -> Command:
    """Return a read that any drive of a dialect answers."""
    reads = (c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.models)
    return next(c for c in reads if not c.request_forms[0].layout.fields)


def answers(probe: Probe, address: int | None = None) -> bool:
    """Say whether the drive answers a read (at an address), asked three times: one reply may be lost."""
    read = plain_read(probe.dialect)
    asked = (probe.ask(read, address=address) for _ in range(3))
    return any(a.message.frame.checksum_ok and a.command is not None for exchange in asked for a in exchange.answers)


def sound(probe: Probe) -> None:
    """Raise Inconclusive where the line loses replies or the drive is late: then silence says nothing."""
    read = plain_read(probe.dialect)
    for _ in range(6):
        probe.reply(probe.ask(read))


def sane(probe: Probe) -> None:
    """Raise Inconclusive where a plain read is not answered once, by the drive that was asked.

    What a drive makes of values cannot be told from answers that are echoes, doubled or under another address.
    """
    exchange = probe.ask(plain_read(probe.dialect))
    answer = probe.reply(exchange)
    if len(exchange.answers) > 1:
        raise Inconclusive(f"a read is answered by {len(exchange.answers)} frames")
    if answer.message.address != probe.address:
        raise Inconclusive(f"a read is answered under the address {answer.message.address}")


def resting(claim: Claim) -> Claim:
    """Return a claim that is inconclusive where it rests on a drive whose answers to a plain read are not `sane`."""

    def check(probe: Probe) -> None:
        sane(probe)
        claim.check(probe)

    return replace(claim, check=check)


def once(statuses: Sequence[int]) -> list[int]:
    """Return statuses. Raises Inconclusive where one of them came twice: other claims are about that."""
    if any(a == b for a, b in pairwise(statuses)):
        raise Inconclusive(f"a reply came twice: {', '.join(map(str, statuses))}")
    return list(statuses)


def judged(probe: Probe, exchange: Exchange) -> Taken:
    """Return how the request of an exchange was taken. Raises Inconclusive where its answer says neither."""
    answer = probe.reply(exchange)
    command = exchange.command
    assert command is not None  # it was asked for
    if answer.command is not None and answer.command.function != command.function:
        raise Inconclusive(f"{command.name} was answered under another function: {answer.data.hex(' ').upper()}")
    forms = {a.message.form.name for a in exchange.answers if a.message.form is not None}
    if forms & command.replies.failed_forms and len(forms) > 1:
        raise Inconclusive(f"{command.name} was answered both ways")
    if probe.refused(exchange):
        return Taken.REFUSED
    replies = command.replies
    status = answer.values.get(replies.status)
    if replies.final | replies.interim:
        if status not in replies.final | replies.interim:
            raise Inconclusive(f"{command.name} was answered {answer.data.hex(' ').upper()}, which says neither yes nor no")
    elif answer.message.form is None or answer.message.form.name not in {f.name for f in command.reply_forms}:
        raise Inconclusive(f"{command.name} was answered {answer.data.hex(' ').upper()}, which is no reply of it")
    return Taken.DONE


def take(probe: Probe, built: Built) -> tuple[Taken, Exchange]:
    """Send a request and return how it was taken. Raises Inconclusive where that cannot be said."""
    exchange = probe.ask_built(built)
    if exchange.answers or exchange.junk:
        return judged(probe, exchange), exchange
    read = plain_read(probe.dialect)
    for _ in range(2):
        probe.reply(probe.ask(read))
    for _ in range(2):
        again = probe.ask_built(built)
        if again.answers or again.junk:
            raise Inconclusive(f"{built.command.name} was answered only when it was sent again")
    return Taken.SILENT, exchange


def accept(probe: Probe, command: Command, values: Mapping[str, Any], what: str, *, form: Form | None = None) -> Exchange:
    """Send a request that the manual allows, and refute where the drive does not take it. `what` names it for people."""
    taken, exchange = take(probe, probe.build(command, values, form=form))
    if taken is not Taken.DONE:
        raise Refuted(
            f"{command.name}: {what} is {taken.value}",
            expected=f"{_done(command)}: the manual allows it",
            got=_got(exchange),
            exchange=exchange,
            key=f"{command.name} {taken.value}",
        )
    return exchange


def refuse(probe: Probe, built: Built, what: str) -> Exchange:
    """Send a request that the manual forbids, and refute where the drive takes it or says nothing."""
    taken, exchange = take(probe, built)
    if taken is not Taken.REFUSED:
        raise Refuted(
            f"{built.command.name}: {what} is {'accepted' if taken is Taken.DONE else taken.value}",
            expected=f"{_refused(built.command)}: the manual does not allow it",
            got=_got(exchange),
            exchange=exchange,
            key=f"{built.command.name} {taken.value}",
        )
    return exchange


def with_reserved(probe: Probe, command: Command, form: Form, values: Mapping[str, Any], mask: int) -> Built:
    """Return a request with bits of `mask` set beside its values."""
    data = with_bits(form.layout, values, mask)
    frame = probe.dialect.link.build(command, form, probe.address, data, Role.REQUEST)
    return replace(probe.build(command, values, form=form), frame=frame, risks=command.risks(values), refusals=())


def _done(command: Command) -> str:
    good = sorted(command.replies.final | command.replies.interim)
    return f"status {' or '.join(map(str, good))}" if good else "an echo"


def _refused(command: Command) -> str:
    failed = sorted(command.replies.failed)
    if failed:
        return f"status {' or '.join(map(str, failed))}"
    return "FFFFh in place of the value" if command.function == 0x06 else "a quantity of 0"


def _got(exchange: Exchange) -> str:
    answer = exchange.reply
    return "silence" if answer is None else answer.data.hex(" ").upper()
