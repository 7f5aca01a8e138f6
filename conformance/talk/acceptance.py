"""Whether a drive accepts a request: done, refused, or not answered.

    expect_accepted(probe, command, values, "current 800")    refutes where the drive refuses
    expect_refused(probe, built, "current 9000")              refutes where the drive does it all the same

The catalogue says what a refusal is: a status that failed, or a form of the reply (Modbus: FFFFh, a quantity of 0).

Rules kept here:
- An answer that cannot be read, or whose status is in no list, raises Inconclusive: the theme shape judges it.
- Silence counts only where the drive answers reads before and after it, and the request stays unanswered when it is sent
  again. A line that loses a reply now and then is not a drive that ignores a value.
- An exception is a refusal too; the theme modbus judges whether it is the right one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Form, Risk
from analyzer.encoder import Built
from conformance.claim import Inconclusive
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: How many reads a line must carry before the silence of a drive says something.
_RELIABLE = 6
#: One request of so many a line may lose.
_RARELY = 20


class Acceptance(Enum):
    """How a drive answered a request."""

    DONE = "done"
    REFUSED = "refused"
    SILENT = "not answered"


def can_refuse(command: Command) -> bool:
    """Say whether a reply of a command can say that it was refused."""
    return bool(command.replies.failed or command.replies.failed_forms)


def plain_read(dialect: Dialect) -> Command:
    """Return a read that every drive of a dialect answers."""
    reads = (c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.models)
    return next(c for c in reads if not c.request_forms[0].layout.fields)


# --- the line and the drive as such -----------------------------------------------------------------------------------


def answers(probe: Probe, address: int | None = None) -> bool:
    """Say whether the drive answers a read (at an address), asked three times: one reply may be lost."""
    return any(is_there(probe, address, quiet_ns=None) for _ in range(3))


def is_there(probe: Probe, address: int | None = None, *, most_ns: float = math.inf, quiet_ns: int | None = 0) -> bool:
    """Say whether a drive that may be elsewhere, or may start, answers a read, asked once.

    Silence is an answer here, and nothing that the line has lost.
    """
    timeout_ns = int(min(most_ns, probe.rig.silence_ns))
    exchange = probe.ask(plain_read(probe.dialect), address=address, timeout_ns=timeout_ns, quiet_ns=quiet_ns)
    exchange.awaited = False
    return any(a.message.frame.checksum_ok and a.command is not None for a in exchange.answers)


def need_reliable_replies(probe: Probe) -> None:
    """Raise Inconclusive where the line loses replies or the drive is late: then silence says nothing."""
    read = plain_read(probe.dialect)
    for left in reversed(range(_RELIABLE)):
        # What is told twice is heard behind the last one.
        probe.reply(probe.ask(read, quiet_ns=0 if left else None), once_more=False)


def need_plain_replies(probe: Probe) -> None:
    """Raise Inconclusive unless the drive answers a plain read once, under its own address.

    Echoes, doubled replies and replies under another address do not show how the drive treats a value.
    """
    rig = probe.rig
    exchange = probe.ask(plain_read(probe.dialect), quiet_ns=0 if rig.answers_once else None)
    answer = probe.reply(exchange)
    if len(exchange.answers) > 1:
        raise Inconclusive(f"a read is answered by {len(exchange.answers)} frames")
    if answer.message.address != probe.address:
        raise Inconclusive(f"a read is answered under the address {answer.message.address}")
    rig.answers_once = not rig.emulated


def without_repeats(statuses: Sequence[int]) -> list[int]:
    """Return statuses. Raises Inconclusive where one of them came twice in a row, which the theme shape judges."""
    if any(a == b for a, b in pairwise(statuses)):
        raise Inconclusive(f"a reply came twice: {', '.join(map(str, statuses))}")
    return list(statuses)


# --- one request ------------------------------------------------------------------------------------------------------


def acceptance(probe: Probe, exchange: Exchange) -> Acceptance:
    """Return how the request of an exchange was answered. Raises Inconclusive where its answer says neither yes nor no."""
    answer = probe.reply(exchange)
    command = exchange.command
    assert command is not None  # it was asked for
    text = answer.data.hex(" ").upper()
    if answer.command is not None and answer.command.function != command.function:
        raise Inconclusive(f"{command.name} was answered under another function: {text}")
    forms = {a.message.form.name for a in exchange.answers if a.message.form is not None}
    if forms & command.replies.failed_forms and len(forms) > 1:
        raise Inconclusive(f"{command.name} was answered both ways")
    if probe.refused(exchange):
        return Acceptance.REFUSED
    replies = command.replies
    if replies.final | replies.interim:
        if answer.values.get(replies.status) not in replies.final | replies.interim:
            raise Inconclusive(f"{command.name} was answered {text}, which says neither yes nor no")
    elif answer.message.form is None or answer.message.form.name not in {f.name for f in command.reply_forms}:
        raise Inconclusive(f"{command.name} was answered {text}, which is no reply of it")
    return Acceptance.DONE


def try_request(probe: Probe, built: Built) -> tuple[Acceptance, Exchange]:
    """Send a request and return how it was answered. Raises Inconclusive where that cannot be said."""
    exchange = probe.ask_built(built)
    if exchange.answers or exchange.junk:
        sound = probe.sound(exchange)
        return acceptance(probe, sound), sound
    read = plain_read(probe.dialect)
    for _ in range(2):
        probe.reply(probe.ask(read))
    for _ in range(2):
        again = probe.ask_built(built)
        if again.answers or again.junk:
            if sum(e.unanswered for e in probe.traffic) * _RARELY > len(probe.traffic):
                raise Inconclusive(f"{built.command.name} was answered only when it was sent again")
            return acceptance(probe, again), again
    return Acceptance.SILENT, exchange


def expect_accepted(
    probe: Probe, command: Command, values: Mapping[str, Any], what: str, *, form: Form | None = None
) -> Exchange:
    """Send a request that the manual allows; the claim is refuted unless the drive does it. `what` names it for people."""
    answer, exchange = try_request(probe, probe.build(command, values, form=form))
    probe.expect(
        _got(exchange),
        holds=answer is Acceptance.DONE,
        expected=f"{_success(command)}: the manual allows it",
        refutes=f"{command.name}: {what} is {answer.value}",
        exchange=exchange,
        key=f"{command.name} {answer.value}",
    )
    return exchange


def expect_refused(probe: Probe, built: Built, what: str) -> Exchange:
    """Send a request that the manual forbids; the claim is refuted unless the drive refuses it."""
    answer, exchange = try_request(probe, built)
    probe.expect(
        _got(exchange),
        holds=answer is Acceptance.REFUSED,
        expected=f"{_refusal(built.command)}: the manual does not allow it",
        refutes=f"{built.command.name}: {what} is {'accepted' if answer is Acceptance.DONE else answer.value}",
        exchange=exchange,
        key=f"{built.command.name} {answer.value}",
    )
    return exchange


def _success(command: Command) -> str:
    good = sorted(command.replies.final | command.replies.interim)
    return f"status {' or '.join(map(str, good))}" if good else "an echo"


def _refusal(command: Command) -> str:
    failed = sorted(command.replies.failed)
    if failed:
        return f"status {' or '.join(map(str, failed))}"
    return "FFFFh in place of the value" if command.function == 0x06 else "a quantity of 0"


def _got(exchange: Exchange) -> str:
    answer = exchange.reply
    return "silence" if answer is None else answer.data.hex(" ").upper()
