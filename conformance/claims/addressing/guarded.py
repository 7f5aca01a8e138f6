"""What must not move, switch or rename a motor: requests whose checks are wrong, and requests to other addresses.

What is executed though it is not answered shows by the rows of `guarded_commands`.

Rules kept here:
- What was to have no effect is sent whole at last, so that a drive that does nothing at all proves nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Role, Subject, Verb
from analyzer.encoder import Built
from conformance.claim import Inconclusive, Theme
from conformance.claims.addressing.guarded_commands import (
    MOTION,
    MOTIONS,
    RPM,
    WATCH_NS,
    Guarded,
    every_guarded,
    leave,
    repeatable,
    risks,
)
from conformance.claims.control_reads import PAUSE_NS, expect_silence
from conformance.claims.declare import Case, claim, described_in
from conformance.claims.known_quirks import may_meet
from conformance.claims.known_reads import every_read, is_stored, plain_reads
from conformance.claims.motion.motion_claim import command_of
from conformance.claims.settings.known_settings import ReadableSetting, needs, readable_settings
from conformance.model import lk_parameters
from conformance.motion import declared, motion
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import MS, Probe

#: The most bytes of a CAN frame.
_CAN_BYTES = 8

_of_guarded = partial(claim, refuted_by="an effect of it", risks=risks, parameters={})
_of_framing = partial(claim, Theme.FRAMING, section=described_in(Subject.FRAMING), parameters={})


def _spoiled(probe: Probe, built: Built, bits: tuple[int, ...] = (0,)) -> Iterator[tuple[str, Exchange]]:
    """Send a request with each of its checks spoiled, in one bit at a time; yield the check and what was sent last."""
    for check in probe.dialect.link.checks(built.frame, probe.address):
        for bit in bits:
            changed = bytearray(built.frame)
            changed[check.start] ^= 1 << bit
            sent = probe.send(built.item(bytes(changed)), timeout_ns=PAUSE_NS)
        yield check.name, sent


def _expect_no_effect(probe: Probe, guarded: Guarded, before: float, sent: Exchange, refutes: str, key: str = "") -> None:
    probe.wait(WATCH_NS)
    after = guarded.see(probe)
    shows = guarded.shows(probe, before, after)
    if shows:
        leave(probe, guarded)
    expected = f"{before:g} still, after {hex_of(sent.sent or b'')}"
    probe.expect(f"{after:g}", holds=not shows, expected=expected, refutes=refutes, exchange=sent, key=key)


def _control(probe: Probe, command: Command, guarded: Guarded, values: Mapping[str, int]) -> None:
    """Send the request whole. Raises Inconclusive where it shows no effect."""
    before = guarded.see(probe)
    probe.do(command, values)
    probe.wait(WATCH_NS)
    after = guarded.see(probe)
    leave(probe, guarded)
    if not guarded.shows(probe, before, after):
        raise Inconclusive(f"{command.name} shows no effect when it is sent whole either")


@_of_guarded(Theme.FRAMING, each=every_guarded, name="{command}/guarded", section=described_in(Subject.FRAMING))
def _guarded_by_sums(probe: Probe, command: Command, guarded: Guarded) -> None:
    """{command} is not executed where a sum of it is wrong."""
    guarded.ready(probe)
    values = guarded.values(probe, command)
    built = probe.build(command, values)
    before = guarded.see(probe)
    for check, sent in _spoiled(probe, built, bits=(0, 7)):
        _expect_no_effect(probe, guarded, before, sent, f"{command.name} is executed with a wrong {check}")
    if guarded.again:
        _control(probe, command, guarded, values)
    else:
        leave(probe, guarded)


def _with_reads(dialect: Dialect) -> Iterator[Case]:
    if dialect.link.tells_length:
        yield Case(dialect, facts={"commands": tuple(c.name for c in plain_reads(dialect))})


@_of_framing(each=_with_reads, name="reads/guarded", refuted_by="an answer")
def _reads_guarded(probe: Probe) -> None:
    """No read whose check is wrong is answered."""
    for command in plain_reads(probe.dialect):
        for check, sent in _spoiled(probe, probe.build(command)):
            expect_silence(probe, sent, f"{command.name} is answered with a wrong {check}")


def _of_one_length(dialect: Dialect) -> Iterator[Case]:
    """Yield what a dialect whose frames tell their length guards and can be sent again, and its motions."""
    if dialect.link.tells_length:
        guarded = {command_of(case).name: case for case in repeatable(dialect)}
        moves = (Case(dialect, c, {"guarded": MOTION}) for c in dialect.motions(*MOTIONS) if c.name not in guarded)
        yield from (*guarded.values(), *moves)


@_of_framing(
    each=_of_one_length,
    name="{command}/other-length",
    refuted_by="an effect of it",
    risks=lambda case: risks(case) | {Risk.UNKNOWN},
    at_best=Certainty.LIKELY,
)
def _guarded_by_length(probe: Probe, command: Command, guarded: Guarded) -> None:
    """{command} with a byte more or less, or without any, all else fitting, or without its check, is not executed.

    Nor is it after it was, whole. On CAN no other length of a frame is.
    """
    link, form = probe.dialect.link, command.request_forms[0]
    for number in range(2):
        guarded.ready(probe)
        values = guarded.values(probe, command)
        built = probe.build(command, values)
        head = link.parse(built.frame, probe.address)
        data = built.frame[head.start : head.stop]
        before = guarded.see(probe)
        others = [data[:-1], data + b"\0", b""]
        if link.kind == "can" and not number:
            # There are few.
            others = [(data + bytes(_CAN_BYTES))[:n] for n in range(_CAN_BYTES)]
        frames = {
            f"{len(other)} bytes of data in place of {len(data)}": link.build(command, form, probe.address, other, Role.REQUEST)
            for other in others
            if len(other) != len(data)
        }
        if link.kind == "can":
            # On a line the next frame would end it.
            frames["no check"] = built.frame[:-1]
        for what, frame in frames.items():
            if link.kind != "can" or len(frame) <= _CAN_BYTES:
                sent = probe.send(built.item(frame), timeout_ns=PAUSE_NS)
                text = f"{command.name} with {what} is executed"
                _expect_no_effect(probe, guarded, before, sent, text, f"{command.name}: another length is executed")
        _control(probe, command, guarded, values)


# --- settings ---------------------------------------------------------------------------------------------------------


def _with_settings(dialect: Dialect, *more: Risk) -> Iterator[Case]:
    """Yield the settings of a dialect that can be read, all together. `more`: risks beside those of setting them."""
    chosen = readable_settings(dialect)
    if chosen:
        risks, names = needs(chosen)
        yield Case(dialect, given={"chosen": chosen}, facts={"risks": risks | set(more), "settings": names})


@_of_framing(
    each=_with_settings,
    name="settings/guarded",
    refuted_by="a value that is stored",
    quirks=may_meet(lk_parameters.OTHER_FIRMWARE),
)
def _settings_guarded(probe: Probe, chosen: list[ReadableSetting]) -> None:
    """A setting whose check is wrong is not stored."""
    for each in chosen:
        was = each.read(probe)
        values = each.other(was)
        for check, sent in _spoiled(probe, probe.build(each.command, values, form=each.form)):
            text = f"{each.command.name} is stored with a wrong {check}"
            probe.expect(each.read(probe), equal=was, refutes=text, exchange=sent)


@_of_framing(
    each=lambda dialect: _with_settings(dialect, Risk.UNKNOWN) if dialect.link.tells_length else (),
    name="settings/other-length",
    refuted_by="a value that is stored",
    at_best=Certainty.LIKELY,
    quirks=may_meet(lk_parameters.OTHER_FIRMWARE),
)
def _settings_of_one_length(probe: Probe, chosen: list[ReadableSetting]) -> None:
    """A setting with a byte less or with more bytes is not stored."""
    link = probe.dialect.link
    for each in chosen:
        try:
            was = each.read(probe)
        except Inconclusive:
            # Which settings a drive tells is judged elsewhere.
            continue
        built = probe.build(each.command, each.other(was), form=each.form)
        head = link.parse(built.frame, probe.address)
        data = built.frame[head.start : head.stop]
        more = _CAN_BYTES - len(built.frame) if link.kind == "can" else 1
        others = [("a byte less", data[:-1]), *((f"{n} bytes more", data + bytes(n)) for n in range(1, more + 1))]
        frames = {what: link.build(each.command, each.form, probe.address, other, Role.REQUEST) for what, other in others}
        if link.kind == "can":
            # On a line the byte would be one of the next frame.
            frames["a byte behind its check"] = built.frame + b"\0"
        for what, frame in frames.items():
            if link.kind != "can" or len(frame) <= _CAN_BYTES:
                sent = probe.send(built.item(frame), timeout_ns=_SHORT_NS)
                text = f"{each.name} with {what} is stored"
                probe.expect(each.read(probe), equal=was, refutes=text, exchange=sent)


#: How long is listened to a setting that is not to be stored, before it is read.
_SHORT_NS = 20 * MS
#: The work mode in which the suite moves, as sent.
_FULL_CONTROL = 5
#: What switches, stops and turns a drive, in turn; none of it stores anything else than it says.
_DEEDS: tuple[tuple[str, Mapping[str, int]], ...] = (
    ("stop", {}),
    ("motor_off", {}),
    ("motor_on", {}),
    ("clear_errors", {}),
    ("clear_turns", {}),
    ("set_position", {"position": 0}),
    ("emergency_stop", {}),
    ("enable", {"enabled": 0}),
    ("enable", {"enabled": 1}),
    ("set_zero", {}),
    ("release_protection", {}),
    ("set_work_mode", {"work_mode": _FULL_CONTROL}),
)
#: Settings in which a drive would not move or not answer.
_NEEDED = frozenset({Verb.SET_WORK_MODE, Verb.SET_RESPOND})


def _that_stay(dialect: Dialect) -> Iterator[Case]:
    chosen = [each for each in readable_settings(dialect) if each.command.verb not in _NEEDED]
    # Of LK 19h is kept in the flash; the zero of MKS is where the shaft stands.
    deeds = [(n, v) for n, v in _DEEDS if n in dialect.by_name and Risk.WEAR not in dialect.by_name[n].all_risks]
    if chosen and declared.can_move(dialect):
        commands = [
            *(each.command for each in chosen),
            *(dialect.by_name[n] for n, _ in deeds),
            dialect.by_verb[Verb.RUN_SPEED],
        ]
        risks = frozenset[Risk]().union(*(c.all_risks for c in commands)) - {Risk.UNKNOWN}
        _, names = needs(chosen)
        facts = {"risks": declared.risks(dialect, *risks), "settings": declared.settings(dialect, *names)}
        yield Case(dialect, given={"chosen": chosen, "deeds": deeds}, facts=facts)


@claim(
    Theme.READ_BACK,
    each=_that_stay,
    name="settings/stay",
    refuted_by="a value that is another one",
    section=described_in(Subject.FRAMING),
    at_best=Certainty.LIKELY,
    quirks=may_meet(lk_parameters.OTHER_FIRMWARE),
    parameters={},
)
def _stay(probe: Probe, chosen: list[ReadableSetting], deeds: list[tuple[str, Mapping[str, int]]]) -> None:
    """What is stored stays while the motor runs, stops, is switched off and on, and its errors, turns and zero are set."""
    if Verb.SET_WORK_MODE in probe.dialect.by_verb:
        probe.do(Verb.SET_WORK_MODE, {"work_mode": _FULL_CONTROL})
    motion.ready_to_move(probe)
    for each in chosen:
        was = each.read(probe)
        probe.do(each.command, each.other(was))
    kept = _all_stored(probe)
    _expect_kept(probe, kept, "a run", motion.run_at(probe, RPM))
    for name, values in deeds:
        _expect_kept(probe, kept, name, probe.ask(name, values))
    motion.stand_still(probe)


def _all_stored(probe: Probe) -> list[tuple[Command, Mapping[str, Any]]]:
    reads = [(c, values) for c, values in every_read(probe.dialect) if is_stored(c)]
    return [(c, probe.reply(probe.ask(c, values, quiet_ns=0)).values) for c, values in reads]


def _expect_kept(probe: Probe, kept: list[tuple[Command, Mapping[str, Any]]], after: str, exchange: Exchange) -> None:
    for (command, was), (_, now) in zip(kept, _all_stored(probe), strict=True):
        text = f"{command.name} reads another stored value after {after}"
        probe.expect(now, equal=was, refutes=text, exchange=exchange, key=f"another value after {after}")


@_of_guarded(Theme.ADDRESSING, each=repeatable, name="other/{command}", section=described_in(Subject.ADDRESSING), alone=True)
def _to_another(probe: Probe, command: Command, guarded: Guarded) -> None:
    """{command} to another address is not executed."""
    guarded.ready(probe)
    values = guarded.values(probe, command)
    own, (first, last) = probe.address, probe.dialect.addresses
    before = guarded.see(probe)
    # Where an address has a byte and no broadcast, the drive must not hear those that no drive has either.
    bare = probe.dialect.bus == "serial" and probe.dialect.broadcast is None
    byte = (own ^ 0x20, own ^ 0x80, 0xFF) if bare else ()
    near = (a for a in (0, first, own ^ 1, own + 1, last) if a <= last)
    others = [a for a in dict.fromkeys((*near, *byte)) if a not in (own, probe.dialect.broadcast, probe.rig.group)]
    for address in others:
        sent = probe.send(probe.build(command, values, address=address).item(), timeout_ns=PAUSE_NS)
    text = f"{command.name} to {', '.join(map(str, others))} is executed, and the drive is {own}"
    _expect_no_effect(probe, guarded, before, sent, text, f"{command.name}: another address is executed")
    _control(probe, command, guarded, values)
