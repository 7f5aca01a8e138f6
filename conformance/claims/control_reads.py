"""Control reads: good requests that show whether a drive still hears, for claims about bad frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Dialect, Risk, Subject, Verb
from conformance.claim import Inconclusive, Refuted
from conformance.talk import samples
from conformance.talk.exchange import Answer, Exchange, hex_of
from conformance.talk.garbling import Garbler
from conformance.talk.reply_match import in_order

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: The pause between a damaged frame and the next good one, where the claim does not judge the silence between them.
PAUSE_NS = 60_000_000
#: How long a claim listens after it sent plain bytes.
LISTEN_NS = 300_000_000
#: This many good reads in quiet must be answered before a drive counts as deaf.
_CONTROLS = 6
#: Reads that carry data, by verb: a drive must check these data besides the head.
_WITH_DATA: tuple[Verb, ...] = (Verb.READ_PARAMETER, Verb.BRAKE)


def section(dialect: Dialect) -> str:
    """Return the section of the manual that describes frames."""
    return dialect.sections.get(Subject.FRAMING, dialect.commands[0].section)


def plain_reads(dialect: Dialect) -> list[Command]:
    """Return the reads that need no data."""
    return [c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.fields]


def plain_read(dialect: Dialect) -> Command:
    """Return the control read: of the position, or the first read that needs no data."""
    return dialect.by_verb.get(Verb.READ_POSITION) or plain_reads(dialect)[0]


#: Pauses that a host makes now and then.
PAUSES_NS = (1_000_000_000, 5_000_000_000)


def around_silence(probe: Probe, pause_ns: int) -> tuple[Exchange, Exchange]:
    """Ask, listen for a pause and ask again; return what came in the pause, and behind it."""
    read = plain_read(probe.dialect)
    probe.ask(read)
    silence = probe.listen(pause_ns)
    return silence, probe.ask(read)


def garblers(probe: Probe) -> list[Garbler]:
    """Return the garblers of a read without data, and of each kind of read with data in the dialect."""
    dialect = probe.dialect
    found = [Garbler(dialect, probe.build(plain_read(dialect)))]
    for verb in _WITH_DATA:
        command = dialect.by_verb.get(verb)
        if command is not None:
            found.append(Garbler(dialect, probe.build(command, samples.sample(dialect, command, address=probe.address))))
    return found


def received_text(exchange: Exchange) -> str:
    """Return the received bytes as hex, for people."""
    return exchange.received.hex(" ").upper() or ("silence" if exchange.silent else "a frame without data")


def expect_silence(probe: Probe, sent: Exchange, refutes: str, *, key: str = "") -> None:
    """Refute where anything came behind what was sent."""
    expected = f"silence after {hex_of(sent.sent or b'')}"
    probe.expect(received_text(sent), holds=sent.silent, expected=expected, refutes=refutes, exchange=sent, key=key)


def is_answered(exchange: Exchange) -> bool:
    """Say whether a frame of the same command and address, with a good checksum, answered; an exception is no answer."""
    asked = exchange.command.name if exchange.command is not None else ""
    named = (a for a in exchange.answers if a.command is not None and a.command.name == asked)
    good = (a for a in named if a.message.address == exchange.address)
    return any(a.message.frame.checksum_ok and not is_exception(a) for a in good)


def is_exception(answer: Answer) -> bool:
    """Say whether an answer is a Modbus exception."""
    return "exception" in answer.values


def ask_first(probe: Probe) -> None:
    """Send a control read. Raises Inconclusive where the drive does not answer it."""
    exchange = probe.ask(plain_read(probe.dialect))
    probe.reply(exchange)
    if not is_answered(exchange):
        raise Inconclusive(f"a good request is answered {received_text(exchange)}, which another claim judges")


def answered_by(probe: Probe, sent: Exchange, *commands: Command) -> bool:
    """Say whether a good reply to each of these commands came back, in this order, and nothing else."""
    return in_order(sent, probe.dialect, commands, probe.address)


def expect_checked(probe: Probe, bad: Sequence[Exchange], of: Sequence[Exchange], refutes: str) -> None:
    """Refute where the replies to some of many requests do not check. Raises Inconclusive where none of them does."""
    for exchange in bad[:1]:
        if len(bad) == len(of):
            assert exchange.command is not None  # it was asked for
            raise Inconclusive(f"no reply to {exchange.command.name} can be read, which another claim judges")
        got, expected = received_text(exchange), "replies whose checks fit"
        key = "replies in a row are garbled"
        probe.expect(got, holds=False, expected=expected, refutes=refutes, exchange=exchange, key=key)


def ask_alone(probe: Probe) -> None:
    """Send a control read alone. Raises Inconclusive unless exactly one good reply answers it."""
    read = plain_read(probe.dialect)
    sent = probe.send(probe.build(read).item())
    if not answered_by(probe, sent, read):
        raise Inconclusive(f"a good request by itself is answered {received_text(sent)}, which another claim judges")


def _answers_read(probe: Probe) -> tuple[bool, Exchange]:
    exchange = probe.ask(plain_read(probe.dialect), quiet_ns=0)
    return is_answered(exchange), exchange


def judge_next(probe: Probe, what: str, send: Callable[[], Exchange]) -> None:
    """Send something, then a good read that must be answered. `what` names what was sent, for people.

    Raises Refuted where the read is twice not answered; Inconclusive where reads in quiet are lost too.
    """
    for last in (False, True):
        sent = send()
        is_heard, exchange = _answers_read(probe)
        if is_heard:
            if last:
                raise Inconclusive(f"the good request behind {what} was not answered, and when sent again it was")
            return
        if last:
            break
        if not all(_answers_read(probe)[0] for _ in range(_CONTROLS)):
            raise Inconclusive("good requests are not always answered, also where nothing is sent before them")
    before = f", sent behind {hex_of(sent.sent)}" if sent.sent is not None else ""
    raise Refuted(
        f"the good request behind {what} is not answered",
        expected=f"a reply to {hex_of(exchange.sent or b'')}{before}",
        got=received_text(exchange),
        exchange=exchange,
        key="the next good request is not answered",
    )
