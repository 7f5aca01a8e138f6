"""Resilience: a drive goes on hearing through many requests, floods, noise, idle hours and lost power.

What arrives while it moves, homes or calibrates stands in `resilience.busy`.

Rules kept here:
- Requests that are looked at are reads, so that all of it can run on any drive.
- Noise consists of bytes that begin no frame in any dialect; bytes of every kind go to emulated drives alone.
- A drive may drop what comes faster than it can; what must hold is that the next request behind a pause is answered.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Subject, Verb
from analyzer.link import CanLink
from analyzer.records import CanFrame
from analyzer.values import CAN_ID_LIMIT
from conformance.claim import Inconclusive, Theme
from conformance.claims.control_reads import (
    LISTEN_NS,
    PAUSE_NS,
    PAUSES_NS,
    around_silence,
    ask_first,
    expect_checked,
    is_answered,
    judge_next,
    plain_read,
    received_text,
)
from conformance.claims.declare import Case, claim, commands, described_in
from conformance.claims.known_quirks import HASTY, may_meet
from conformance.claims.known_reads import plain_reads
from conformance.claims.modbus import frames
from conformance.claims.settings.known_settings import Setting, every_setting, needs
from conformance.model import limits
from conformance.model.lk_parameters import OTHER_FIRMWARE
from conformance.motion import motion
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until

_SECOND_NS = 1_000_000_000
_MANY = 100
_TRIES = 3
_FLOOD = 40
#: Bytes of noise at a time, and in all.
_PIECE, _PIECES = 64, 32
_SEED = 20_241
#: Pauses after which the first request is looked at, each of them twice at most: those that every run has time for, and others.
_LONG_PAUSES_NS = (31 * _SECOND_NS, 61 * _SECOND_NS)
_LONG_IDLE_NS = 24 * 3600 * _SECOND_NS
#: Settings that refuse a value and risk nothing. A function that reads, and a register, which no drive has.
_REFUSING = (Verb.SET_SCREEN_OFF, Verb.SET_KEY_LOCK, Verb.SET_INTERPOLATION, Verb.SET_DIRECTION)
_OTHER_FUNCTION, _NO_REGISTER = 0x03, 0x0035
#: How long a drive may take from power-on until it answers; real ones take two seconds.
_POWER_NS = 4 * _SECOND_NS


def _resilience(refuted_by: str, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"section": described_in(Subject.FRAMING), "parameters": {}, **facts}
    return claim(Theme.RESILIENCE, refuted_by=refuted_by, **facts)


# --- many reads -------------------------------------------------------------------------------------------------------


@_resilience(
    "a reply that is garbled", name="reads/good", statement=f"The replies to {_MANY} reads in a row all check.", of_line=True
)
def _reads_check(probe: Probe) -> None:
    read = plain_read(probe.dialect)
    exchanges = [probe.ask(read, quiet_ns=0) for _ in range(_MANY)]
    bad = [e for e in exchanges if e.damaged]
    expect_checked(probe, bad, exchanges, f"the line or the drive damages {len(bad)} of the replies to {_MANY} reads in a row")


@_resilience("the reply of another read", name="reads/mixed")
def _reads_mixed(probe: Probe) -> None:
    """Reads of many kinds in any order are each answered by their own reply."""
    readable = [c for c in plain_reads(probe.dialect) if _answered_alone(probe, c)]
    if not readable:
        raise Inconclusive("no read by itself is answered by one good reply")
    chance, foreign = random.Random(_SEED), 0
    for _ in range(_MANY):
        command = chance.choice(readable)
        exchange = probe.ask(command, quiet_ns=0)
        if not exchange.silent and not is_answered(exchange):
            # A line that damages replies makes none of another read.
            foreign += any(a.message.frame.checksum_ok and a.command is not None for a in exchange.answers)
            text = f"{foreign} reads among others are answered by sound replies to other reads"
            probe.expect(foreign, at_most=1, refutes=text, exchange=exchange, key="reads are mixed up")
            again = probe.ask(command, quiet_ns=0)
            probe.expect(
                received_text(again),
                holds=is_answered(again),
                expected=f"a reply to {command.name}",
                refutes=f"{command.name} among other reads is answered by something else",
                exchange=again,
                key="reads are mixed up",
            )


def _answered_alone(probe: Probe, command: Command) -> bool:
    """Say whether a read by itself is answered by one good reply and nothing else."""
    exchange = probe.ask(command)
    return is_answered(exchange) and len(exchange.answers) == 1 and not exchange.junk


@_resilience("another position", each=commands(Verb.READ_POSITION), name="reads/steady", at_best=Certainty.LIKELY)
def _reads_steady(probe: Probe, command: Command) -> None:
    """The position of a shaft that stands reads the same again and again."""
    first = motion.position(probe)
    for _ in range(_MANY // 2):
        text = "the position of a standing shaft changes"
        probe.expect(motion.position(probe), near=first.value, unit="degrees", refutes=text)


# --- what the next request comes behind -------------------------------------------------------------------------------

Sends = Callable[[Probe], Exchange]


def _flood(probe: Probe) -> Exchange:
    """Send reads without waiting for their replies."""
    item = probe.build(plain_read(probe.dialect)).item()
    for _ in range(_FLOOD - 1):
        probe.send(item, timeout_ns=0)
    return probe.send(item, timeout_ns=LISTEN_NS + _FLOOD * PAUSE_NS)


def _heap(probe: Probe) -> Exchange:
    """Send reads as one heap of bytes."""
    return probe.send(probe.build(plain_read(probe.dialect)).frame * _FLOOD, timeout_ns=LISTEN_NS)


def _harmless_noise(size: int, seed: int) -> bytes:
    """Return bytes at random that begin no frame of any dialect."""
    chance = random.Random(seed)
    return bytes(chance.randrange(0xA0, 0xF8) for _ in range(size))


def _long_noise(probe: Probe) -> Exchange:
    for number in range(_PIECES - 1):
        probe.send(_harmless_noise(_PIECE, _SEED + number), timeout_ns=0)
    return probe.send(_harmless_noise(_PIECE, _SEED), timeout_ns=LISTEN_NS)


def _flat_line(probe: Probe) -> Exchange:
    for byte in (b"\0", b"\xff"):
        last = probe.send(byte * _PIECE * _PIECES, timeout_ns=LISTEN_NS)
    return last


def _any_bytes(probe: Probe) -> Exchange:
    chance = random.Random(_SEED)
    for _ in range(_PIECES):
        last = probe.send(chance.randbytes(_PIECE), timeout_ns=LISTEN_NS)
    return last


def _foreign_frames(probe: Probe) -> Exchange:
    chance = random.Random(_SEED)
    read = probe.build(plain_read(probe.dialect))
    for _ in range(_FLOOD):
        can_id = chance.randrange(1, CAN_ID_LIMIT + 1)
        if probe.dialect.link.parse(read.frame, can_id).address != probe.address:
            last = probe.send(CanFrame(None, "bus", can_id, read.frame[:-1] + bytes((chance.randrange(256),))), timeout_ns=0)
    probe.wait(LISTEN_NS)
    return last


def _disturbances(dialect: Dialect) -> Iterator[Case]:
    """Yield what the next request can come behind: name, in words, what sends it, what it needs."""
    size = _PIECES * _PIECE
    anything = {"alone": True, "emulated": True, "risks": frozenset(Risk) - {Risk.READ}}
    rows: list[tuple[str, str, Sends, dict[str, Any]]] = [("flood", f"{_FLOOD} reads without a wait between", _flood, {})]
    if isinstance(dialect.link, CanLink):
        rows.append(("noise/frames", "frames of other drives", _foreign_frames, {"alone": True}))
    else:
        rows += [
            ("heap", f"{_FLOOD} reads in one heap", _heap, {}),
            ("noise/long", f"{size} bytes of noise", _long_noise, {}),
            ("noise/flat", "a line that hangs at 0 or 1", _flat_line, {}),
            ("noise/anything", f"{size} bytes of any kind", _any_bytes, anything),
        ]
    for kind, what, send, facts in rows:
        name = kind if "/" in kind else f"{kind}/next"
        yield Case(dialect, given={"what": what, "send": send}, facts={"name": name, **facts})


@_resilience("silence, or another answer", each=_disturbances, at_best=Certainty.LIKELY)
def _behind(probe: Probe, what: str, send: Sends) -> None:
    """The next request behind {what} is answered."""
    ask_first(probe)
    judge_next(probe, what, partial(send, probe))


# --- what the next request comes behind: a refusal ---------------------------------------------------------------------


def _denied_register(probe: Probe, function: int, register: int, quantity: int) -> Exchange:
    return frames.ask(probe, frames.request(probe, function, register, quantity))


def _denied_value(probe: Probe, command: Command, values: Mapping[str, int]) -> Exchange:
    return probe.ask(command, values, quiet_ns=0)


def _refusals(dialect: Dialect) -> Iterator[Case]:
    """Yield each kind of request that is refused: name, in words, what sends it, what it needs."""
    rows: list[tuple[str, str, Sends, dict[str, Any]]] = []
    command = next((dialect.by_verb[verb] for verb in _REFUSING if verb in dialect.by_verb), None)
    if command is not None:
        field = next(iter(command.request_forms[0].layout.named.values()))
        wrong = partial(_denied_value, command=command, values={field.name: limits.beyond(field)[0]})
        rows.append(("value", "a refused value", wrong, {"risks": command.all_risks, "settings": (field.name,)}))
    read = plain_read(dialect)
    if read.function is not None:
        for kind, function, register, quantity in (
            ("function", _OTHER_FUNCTION, read.code, read.quantity),
            ("register", read.function, _NO_REGISTER, 1),
            ("quantity", read.function, read.code, read.quantity + 1),
        ):
            ask = partial(_denied_register, function=function, register=register, quantity=quantity)
            rows.append((kind, f"an exception to a {kind}", ask, {}))
    parameters = dialect.by_verb.get(Verb.READ_PARAMETER)
    if parameters is not None and parameters.replies.failed_forms:
        (field,) = parameters.request_forms[0].layout.named.values()
        other = partial(_denied_value, command=parameters, values={field.name: read.code})
        rows.append(("parameter", "a read of what is no parameter", other, {}))
    for kind, what, send, facts in rows:
        yield Case(dialect, given={"what": what, "send": send}, facts={"name": f"refused/{kind}", **facts})


@_resilience("silence, or another answer", each=_refusals)
def _behind_refusal(probe: Probe, what: str, send: Sends) -> None:
    """The next request behind {what} is answered."""
    ask_first(probe)
    judge_next(probe, what, partial(send, probe))


# --- what may have changed a drive for good ---------------------------------------------------------------------------


def _power_cycle(probe: Probe) -> Exchange:
    assert probe.drive is not None  # claims about power are for emulated drives
    probe.drive.power_cycle(probe.gate.now_ns())
    return probe.listen(_POWER_NS)


def _power_cycle_in_frame(probe: Probe) -> Exchange:
    frame = probe.build(plain_read(probe.dialect)).frame
    probe.send(frame[: len(frame) // 2], timeout_ns=0)
    return _power_cycle(probe)


def _events(dialect: Dialect) -> Iterator[Case]:
    """Yield what a drive must answer after: name, in words, what does it, whether it needs an emulated drive."""
    rows: list[tuple[str, str, Sends, bool]] = [
        ("idle/day", "a day of silence", lambda probe: probe.listen(_LONG_IDLE_NS), True),
        ("power/back", "power off and on", _power_cycle, True),
    ]
    if not isinstance(dialect.link, CanLink):
        rows.append(("power/in_frame", "power off and on amid a request", _power_cycle_in_frame, True))
    for name, what, happen, emulated in rows:
        yield Case(dialect, given={"what": what, "happen": happen}, facts={"name": name, "emulated": emulated})


@_resilience("silence, or another answer", each=_events, at_best=Certainty.LIKELY)
def _after(probe: Probe, what: str, happen: Sends) -> None:
    """The drive answers after {what}."""
    ask_first(probe)
    happen(probe)
    read = plain_read(probe.dialect)
    tries = [probe.ask(read) for _ in range(_TRIES)]
    probe.expect(
        received_text(tries[-1]),
        holds=any(is_answered(each) for each in tries),
        expected=f"a reply to {read.name}",
        refutes=f"the drive does not answer after {what}",
        exchange=tries[-1],
    )


def _pauses(dialect: Dialect) -> Iterator[Case]:
    for name, pauses, words in (("first", PAUSES_NS, "seconds"), ("first-long", _LONG_PAUSES_NS, "a minute, and half of one,")):
        yield Case(
            dialect,
            given={"pauses": pauses, "words": words},
            facts={"name": f"idle/{name}", "by_name": pauses is _LONG_PAUSES_NS},
        )


@_resilience("silence, pause after pause", each=_pauses, at_best=Certainty.LIKELY)
def _first_after_idle(probe: Probe, pauses: tuple[int, ...]) -> None:
    """The first request after {words} of silence is answered."""
    ask_first(probe)
    read = plain_read(probe.dialect)
    for pause_ns in pauses:
        _, exchange = probe.recorded(around_silence, pause_ns)
        if not is_answered(exchange):
            # A line loses a reply now and then, and not after each pause.
            _, exchange = around_silence(probe, pause_ns)
        probe.expect(
            received_text(exchange),
            holds=is_answered(exchange),
            expected=f"a reply to {read.name}",
            refutes=f"the first request after {pause_ns / _SECOND_NS:g} s of silence is not answered",
            exchange=exchange,
            key="the first request after a pause is lost",
        )


# --- settings in haste ------------------------------------------------------------------------------------------------


#: Settings that risk nothing and move nothing.
_HARMLESS = (Verb.SET_SCREEN_OFF, Verb.SET_PULSE_DELAY, Verb.WRITE_USER_ID, Verb.WRITE_PARAMETER)


def _harmless_settings(dialect: Dialect) -> Iterator[Case]:
    for setting in [each for each in every_setting(dialect) if each.command.verb in _HARMLESS][:1]:
        risks, names = needs([setting])
        facts = {"name": "hasty_settings", "settings": names, "risks": risks, "parameters": {}}
        yield Case(dialect, setting.command, {"setting": setting}, facts)


@_resilience("silence", each=_harmless_settings, at_best=Certainty.LIKELY, quirks=may_meet(HASTY, OTHER_FIRMWARE), hasty=True)
def _in_haste(probe: Probe, command: Command, setting: Setting) -> None:
    """Settings at once behind one another are each answered."""
    one, other = setting.values
    items = [probe.build(command, values, form=setting.form).item() for values in (one, other, one)]
    first = probe.ask(command, one, form=setting.form)
    if first.silent and OTHER_FIRMWARE in probe.claim.quirks:
        probe.meets(OTHER_FIRMWARE)
        return
    probe.reply(first)
    sent = [probe.send(item, until=Until.REPLY, timeout_ns=LISTEN_NS, at_once=True) for item in items]
    if not any(exchange.silent for exchange in sent):
        return
    # Alone, behind a pause, each must be answered: else it is not the haste.
    for item in items:
        probe.wait(2 * probe.rig.write_gap_ns)
        later = probe.send(item, timeout_ns=LISTEN_NS)
        if later.silent:
            raise Inconclusive(f"{command.name} is not always answered, in haste or not")
    if HASTY in probe.claim.quirks:
        probe.meets(HASTY)
        return
    got = "silence, and a reply when it was sent again behind a pause"
    text = "a setting at once behind another one is not answered"
    probe.expect(got, holds=False, expected="a reply to each", refutes=text, exchange=later)
