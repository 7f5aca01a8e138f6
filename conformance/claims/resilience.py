"""Resilience: a drive goes on hearing through many requests, floods, noise, idle hours and lost power.

What arrives while it moves, homes or calibrates stands in `conformance.claims.resilience_busy`.

Rules kept here:
- Requests that are looked at are reads, so that all of it can run on any drive.
- Noise consists of bytes that begin no frame in any dialect; bytes of every kind go to emulated drives alone.
- A drive may drop what comes faster than it can; what must hold is that the next request behind a pause is answered.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.link import CanLink
from analyzer.records import CanFrame
from conformance.claim import Claim, Inconclusive, Refuted, Theme
from conformance.claims import resilience_busy
from conformance.claims.declare import declare
from conformance.claims.hearing import LISTEN_NS, PAUSE_NS, ask_first, came, is_answered, judge_next, plain_read, section
from conformance.claims.known_quirks import known
from conformance.claims.known_reads import plain_reads
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_SECOND_NS = 1_000_000_000
_MANY = 100
_TRIES = 3
_FLOOD = 40
#: Counts of position in which reads of a shaft that stands may differ, in the smallest step of the read.
_SHIVER = 16
#: Bytes of noise at a time, and in all.
_PIECE, _PIECES = 64, 32
_SEED = 20_241
_IDLE_NS = 10 * _SECOND_NS
_LONG_IDLE_NS = 24 * 3600 * _SECOND_NS
#: How long a drive may take from power-on until it answers; real ones take two seconds.
_POWER_NS = 4 * _SECOND_NS
_HASTY = "hasty-writes-dropped"


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    yield from _reads(dialect)
    yield from _floods(dialect)
    yield from _noise(dialect)
    yield from _idle(dialect)
    yield from _power(dialect)
    yield from _hasty(dialect)
    yield from resilience_busy.claims(dialect)


def _make(dialect: Dialect, name: str, statement: str, refuted_by: str, check: Callable[[Probe], None], **rest: Any) -> Claim:
    rest.setdefault("section", section(dialect))
    return declare(dialect, Theme.RESILIENCE, name, statement, refuted_by, check, **rest)


# --- many reads -------------------------------------------------------------------------------------------------------


def _reads(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)
    every = plain_reads(dialect)

    def answered(probe: Probe) -> None:
        exchanges = [probe.ask(read, quiet_ns=0, timeout_ns=probe.rig.late_ns) for _ in range(_MANY)]
        lost = [e for e in exchanges if e.silent]
        if lost:
            raise Refuted(
                f"{len(lost)} of {_MANY} reads in a row are not answered",
                expected=f"{_MANY} replies",
                got=f"{_MANY - len(lost)} replies",
                exchange=lost[0],
                key="reads in a row are lost",
            )

    def good(probe: Probe) -> None:
        exchanges = [probe.ask(read, quiet_ns=0) for _ in range(_MANY)]
        bad = [e for e in exchanges if e.junk or any(not a.message.frame.checksum_ok for a in e.answers)]
        if len(bad) == _MANY:
            raise Inconclusive(f"no reply to {read.name} can be read, which another claim judges")
        if bad:
            raise Refuted(
                f"{len(bad)} of the replies to {_MANY} reads in a row are garbled",
                expected="replies whose checks fit",
                got=came(bad[0]),
                exchange=bad[0],
                key="replies in a row are garbled",
            )

    def mixed(probe: Probe) -> None:
        known = [c for c in every if _alone(probe, c)]
        if not known:
            raise Inconclusive("no read by itself is answered by one good reply")
        chance = random.Random(_SEED)
        for _ in range(_MANY):
            command = chance.choice(known)
            exchange = probe.ask(command, quiet_ns=0)
            if not exchange.silent and not is_answered(exchange):
                again = probe.ask(command, quiet_ns=0)
                if is_answered(again):
                    continue
                raise Refuted(
                    f"{command.name} among other reads is answered by something else",
                    expected=f"a reply to {command.name}",
                    got=came(again),
                    exchange=again,
                    key="reads are mixed up",
                )

    yield _make(dialect, "reads/answered", f"{_MANY} reads in a row are all answered.", "a reply that does not come", answered)
    yield _make(dialect, "reads/good", f"The replies to {_MANY} reads in a row all check.", "a reply that is garbled", good)
    yield _make(
        dialect, "reads/mixed", "Reads of many kinds in any order are each answered by their own reply.",
        "the reply of another read", mixed,
    )  # fmt: skip
    if Verb.READ_POSITION in dialect.by_verb:
        yield _make(
            dialect, "reads/steady", "The position of a shaft that stands reads the same again and again.",
            "another position", _steady, command=dialect.by_verb[Verb.READ_POSITION], at_best=Certainty.LIKELY,
        )  # fmt: skip


def _alone(probe: Probe, command: Command) -> bool:
    """Say whether a read by itself is answered by one good reply and nothing else."""
    exchange = probe.ask(command)
    return is_answered(exchange) and len(exchange.answers) == 1 and not exchange.junk


def _steady(probe: Probe) -> None:
    read = probe.command(Verb.READ_POSITION)
    found = []
    for _ in range(_MANY // 2):
        exchange = probe.ask(read, quiet_ns=0)
        if is_answered(exchange):
            named = (a for a in exchange.answers if a.command is not None and a.command.name == read.name)
            found.append((next(named).values["position"], exchange))
    if len(found) < _MANY // 4:
        raise Inconclusive("reads of the position are not answered")
    first = found[0][0]
    for value, exchange in found:
        if abs(value - first) > _SHIVER:
            raise Refuted(
                "the position of a standing shaft changes",
                expected=f"{first}, give or take {_SHIVER}",
                got=str(value),
                exchange=exchange,
            )


# --- floods -----------------------------------------------------------------------------------------------------------


def _floods(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)
    can = isinstance(dialect.link, CanLink)

    def flood(probe: Probe) -> Exchange:
        """Send reads without waiting for their replies."""
        item = probe.build(read).item()
        for _ in range(_FLOOD - 1):
            probe.send(item, timeout_ns=0)
        return probe.send(item, timeout_ns=LISTEN_NS + _FLOOD * PAUSE_NS)

    def heap(probe: Probe) -> Exchange:
        """Send reads as one heap of bytes."""
        return probe.send(probe.build(read).frame * _FLOOD, timeout_ns=LISTEN_NS)

    kinds: tuple[tuple[str, str, Callable[[Probe], Exchange]], ...] = (
        ("flood", f"{_FLOOD} reads without a wait between", flood),
        *(() if can else (("heap", f"{_FLOOD} reads in one heap", heap),)),
    )
    for name, what, send in kinds:
        yield _next_claim(dialect, f"{name}/next", what, send)


def _next_claim(dialect: Dialect, name: str, what: str, send: Callable[[Probe], Exchange], **rest: Any) -> Claim:
    def check(probe: Probe) -> None:
        ask_first(probe)
        judge_next(probe, what, partial(send, probe))

    statement = f"The next request behind {what} is answered."
    return _make(dialect, name, statement, "silence, or another answer", check, at_best=Certainty.LIKELY, **rest)


def _after_claim(dialect: Dialect, name: str, what: str, happen: Callable[[Probe], Exchange], **rest: Any) -> Claim:
    """Return the claim that a drive answers after something that may have changed it for good."""
    read = plain_read(dialect)

    def check(probe: Probe) -> None:
        ask_first(probe)
        happen(probe)
        tries = [probe.ask(read) for _ in range(_TRIES)]
        if not any(is_answered(each) for each in tries):
            raise Refuted(
                f"the drive does not answer after {what}",
                expected=f"a reply to {read.name}",
                got=came(tries[-1]),
                exchange=tries[-1],
            )

    statement = f"The drive answers after {what}."
    return _make(dialect, name, statement, "silence, or another answer", check, at_best=Certainty.LIKELY, **rest)


# --- noise ------------------------------------------------------------------------------------------------------------


def _quiet_noise(size: int, seed: int) -> bytes:
    """Return bytes at random that begin no frame of any dialect."""
    chance = random.Random(seed)
    return bytes(chance.randrange(0xA0, 0xF8) for _ in range(size))


def _noise(dialect: Dialect) -> Iterator[Claim]:
    if isinstance(dialect.link, CanLink):
        yield _next_claim(dialect, "noise/frames", "frames of other drives", _foreign_frames, alone=True)
        return

    def long(probe: Probe) -> Exchange:
        for number in range(_PIECES - 1):
            probe.send(_quiet_noise(_PIECE, _SEED + number), timeout_ns=0)
        return probe.send(_quiet_noise(_PIECE, _SEED), timeout_ns=LISTEN_NS)

    def flat(probe: Probe) -> Exchange:
        for byte in (b"\0", b"\xff"):
            last = probe.send(byte * _PIECE * _PIECES, timeout_ns=LISTEN_NS)
        return last

    def anything(probe: Probe) -> Exchange:
        chance = random.Random(_SEED)
        for _ in range(_PIECES):
            last = probe.send(chance.randbytes(_PIECE), timeout_ns=LISTEN_NS)
        return last

    yield _next_claim(dialect, "noise/long", f"{_PIECES * _PIECE} bytes of noise", long)
    yield _next_claim(dialect, "noise/flat", "a line that hangs at 0 or 1", flat)
    yield _next_claim(
        dialect, "noise/anything", f"{_PIECES * _PIECE} bytes of any kind", anything, alone=True, emulated=True,
        risks=frozenset(Risk) - {Risk.READ},
    )  # fmt: skip


def _foreign_frames(probe: Probe) -> Exchange:
    chance = random.Random(_SEED)
    read = probe.build(plain_read(probe.dialect)).frame
    group = 0
    for _ in range(_FLOOD):
        can_id = chance.randrange(1, probe.dialect.addresses[1] + 1)
        if can_id not in (probe.address, group):
            last = probe.send(CanFrame(None, "bus", can_id, read[:-1] + bytes((chance.randrange(256),))), timeout_ns=0)
    probe.wait(LISTEN_NS)
    return last


# --- idle hours, lost power -------------------------------------------------------------------------------------------


def _wait(probe: Probe, duration_ns: int) -> Exchange:
    return probe.listen(duration_ns)


def _idle(dialect: Dialect) -> Iterator[Claim]:
    yield _after_claim(dialect, "idle/seconds", "ten seconds of silence", partial(_wait, duration_ns=_IDLE_NS))
    yield _after_claim(dialect, "idle/day", "a day of silence", partial(_wait, duration_ns=_LONG_IDLE_NS), emulated=True)


def _power_cycle(probe: Probe) -> None:
    assert probe.drive is not None  # claims about power are for emulated drives
    probe.drive.power_cycle(probe.gate.now_ns())


def _power(dialect: Dialect) -> Iterator[Claim]:
    def off_and_on(probe: Probe) -> Exchange:
        _power_cycle(probe)
        return probe.listen(_POWER_NS)

    def in_frame(probe: Probe) -> Exchange:
        frame = probe.build(plain_read(dialect)).frame
        probe.send(frame[: len(frame) // 2], timeout_ns=0)
        _power_cycle(probe)
        return probe.listen(_POWER_NS)

    yield _after_claim(dialect, "power/back", "power off and on", off_and_on, emulated=True)
    if not isinstance(dialect.link, CanLink):
        yield _after_claim(dialect, "power/in_frame", "power off and on amid a request", in_frame, emulated=True)


# --- settings in haste ------------------------------------------------------------------------------------------------


def _hasty(dialect: Dialect) -> Iterator[Claim]:
    command = _setting(dialect)
    if command is None:
        return
    name, field = next(iter(command.request_forms[0].layout.named.items()))
    values = sorted(field.choice_names)[:2] if field.choices is not None else [field.low, field.low + 1]
    quirks = known(dialect, _HASTY)

    def check(probe: Probe) -> None:
        frames = [probe.build(command, {name: v}).item() for v in (*values, values[0])]
        probe.do(command, {name: values[0]})
        lost = [f for f in frames if probe.send(f, timeout_ns=LISTEN_NS).silent]
        if not lost:
            return
        # Alone, behind a pause, each must be answered: else it is not the haste.
        for frame in frames:
            probe.wait(2 * probe.rig.write_gap_ns)
            later = probe.send(frame, timeout_ns=LISTEN_NS)
            if later.silent:
                raise Inconclusive(f"{command.name} is not always answered, in haste or not")
        if quirks:
            probe.meets(_HASTY)
            return
        raise Refuted(
            "a setting at once behind another one is not answered",
            expected="a reply to each",
            got="silence, and a reply when it was sent again behind a pause",
            exchange=later,
        )

    yield _make(
        dialect, "hasty_settings", "Settings at once behind one another are each answered.", "silence", check,
        command=command, at_best=Certainty.LIKELY, risks=command.all_risks, settings=(name,), quirks=quirks,
    )  # fmt: skip


def _setting(dialect: Dialect) -> Command | None:
    """Return a setting that risks nothing and moves nothing."""
    for verb in (Verb.SET_SCREEN_OFF, Verb.SET_PULSE_DELAY, Verb.WRITE_USER_ID):
        if verb in dialect.by_verb:
            return dialect.by_verb[verb]
    return None
