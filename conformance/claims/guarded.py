"""What must not move, switch or rename a motor: requests whose checks are wrong, and requests to other addresses.

What is executed though it is not answered shows in the shaft and in what is read; so these need no hands on the drive.

Rules kept here:
- A damaged motion is one that the same permission allows whole: small, slow, and the sums alone are wrong.
- What was to have no effect is sent whole at last, so that a drive that does nothing at all proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Form, MotionKind, Risk, Role, Subject, Verb
from analyzer.link import CanLink, HeadLink, LkLink
from conformance.claim import Inconclusive, Theme
from conformance.claims.control_reads import PAUSE_NS
from conformance.claims.declare import Case, claim, described_in
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion_claim import command_of
from conformance.claims.setting_effects import differing, stored
from conformance.model import lk_parameters
from conformance.motion import motion
from conformance.motion.motion import MOVES, MS, SAME
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe

#: A motion that shows: degrees, and rpm where it can be told.
_DEGREES, _RPM = 20, 30
#: How long a motion that is executed has until it is looked for; a shaft that went less than `_STILL` (deg) stays.
_WATCH_NS, _STILL = 150 * MS, 4 * SAME
_POWER_OFF, _RELEASED, _READ_BRAKE = 0x00, 0x01, 0x10
_POSITION_STEP = 4_321


def _switch_on(probe: Probe) -> object:
    return motion.switch(probe, True)


@dataclass(frozen=True)
class _Guarded:
    """A command that must not be executed. `ready`: makes it tell; `values`: what is sent; `see`: what it would change.

    `within`: by how much that differs by itself. `after`: puts back what it changed.
    """

    ready: Callable[[Probe], object]
    values: Callable[[Probe, Command], Mapping[str, int]]
    see: Callable[[Probe], float]
    within: float = 0.0
    after: Callable[[Probe], object] = _switch_on


def _shaft(probe: Probe) -> float:
    return motion.position(probe).value


def _is_on(probe: Probe) -> float:
    return float(motion.is_on(probe) is True)


def _brake(probe: Probe) -> float:
    return probe.read(Verb.BRAKE, "brake_state", {"brake_control": _READ_BRAKE})


def _release(probe: Probe) -> object:
    return probe.do(Verb.BRAKE, {"brake_control": _RELEASED})


def _nothing(probe: Probe, command: Command) -> Mapping[str, int]:
    return {}


def _motion_values(probe: Probe, command: Command) -> Mapping[str, int]:
    start = motion.place(probe, command)
    return motion.values_of(probe.dialect, command, _DEGREES, rpm=_RPM, start=start)


def _another_position(probe: Probe, command: Command) -> Mapping[str, int]:
    now = probe.read(Verb.READ_POSITION, "position")
    # Far from the ends of 32 bits, whatever it was.
    return {"position": _POSITION_STEP if abs(now - _POSITION_STEP) > _POSITION_STEP // 2 else -_POSITION_STEP}


def _away(probe: Probe) -> None:
    motion.ready_to_move(probe)
    motion.follow(probe, motion.any_move(probe.dialect), 36)


def _halt(probe: Probe) -> object:
    return probe.ask(Verb.EMERGENCY_STOP)


_MOTION = _Guarded(motion.ready_to_move, _motion_values, _shaft, _STILL)
#: What switches, renames or homes, by the name of the command.
_SWITCHES: Mapping[str, _Guarded] = {
    "enable": _Guarded(motion.ready_to_move, lambda probe, command: {"enabled": 0}, _is_on),
    "home": _Guarded(motion.ready_to_move, _nothing, _shaft, _STILL, after=_halt),
    "motor_off": _Guarded(_switch_on, _nothing, _is_on),
    "motor_on": _Guarded(partial(motion.switch, on=False), _nothing, _is_on),
    "brake": _Guarded(_release, lambda probe, command: {"brake_control": _POWER_OFF}, _brake, after=_release),
    "set_position": _Guarded(motion.ready_to_move, _another_position, _shaft, _STILL),
}
_MOTIONS = (*MOVES, MotionKind.RUN, MotionKind.TORQUE)


#: The most bytes of a CAN frame.
_CAN_BYTES = 8


def _all_guarded(dialect: Dialect) -> Iterator[Case]:
    """Yield what switches, renames or homes, and the motions of the LK drives: those of MKS stand with their frames."""
    if not motion.can_move(dialect):
        return
    for command in dialect.motions(*_MOTIONS) if dialect.family == "lk" else ():
        yield Case(dialect, command, {"guarded": _MOTION})
    for name, guarded in _SWITCHES.items():
        if name in dialect.by_name:
            yield Case(dialect, dialect.by_name[name], {"guarded": guarded})
    # Of LK 19h is kept in the flash, which wears.
    if dialect.family == "mks" and Verb.SET_ZERO in dialect.by_verb:
        zero = _Guarded(_away, _nothing, _shaft, _STILL, after=motion.ready_to_move)
        yield Case(dialect, dialect.by_verb[Verb.SET_ZERO], {"guarded": zero})


def _risks(case: Case) -> frozenset[Risk]:
    command = command_of(case)
    switching = {Risk.TORQUE} if command.verb is Verb.MOTOR_ON else set[Risk]()
    # A damaged frame with a head may be read as another one.
    if isinstance(case.dialect.link, HeadLink):
        switching.add(Risk.UNKNOWN)
    return motion.risks(case.dialect, *(command.all_risks - {Risk.UNKNOWN}), *switching)


_of_guarded = partial(claim, each=_all_guarded, refuted_by="an effect of it", risks=_risks, parameters={})


def _expect_no_effect(probe: Probe, guarded: _Guarded, before: float, sent: Exchange, refutes: str, key: str) -> None:
    probe.wait(_WATCH_NS)
    after = guarded.see(probe)
    if abs(after - before) > guarded.within:
        _leave(probe, guarded)
    expected = f"{before:g} still, after {hex_of(sent.sent or b'')}"
    holds = abs(after - before) <= guarded.within
    probe.expect(f"{after:g}", holds=holds, expected=expected, refutes=refutes, exchange=sent, key=key)


def _control(probe: Probe, command: Command, guarded: _Guarded, values: Mapping[str, int]) -> None:
    """Send the request whole. Raises Inconclusive where it shows no effect."""
    before = guarded.see(probe)
    probe.do(command, values)
    probe.wait(_WATCH_NS)
    after = guarded.see(probe)
    _leave(probe, guarded)
    if abs(after - before) <= guarded.within:
        raise Inconclusive(f"{command.name} shows no effect when it is sent whole either")


def _leave(probe: Probe, guarded: _Guarded) -> None:
    """Leave the motor on and the shaft at rest."""
    guarded.after(probe)
    motion.stand_still(probe)


@_of_guarded(Theme.FRAMING, name="{command}/guarded", section=described_in(Subject.FRAMING))
def _guarded_by_sums(probe: Probe, command: Command, guarded: _Guarded) -> None:
    """{command} is not executed where a sum of it is wrong."""
    guarded.ready(probe)
    values = guarded.values(probe, command)
    built = probe.build(command, values)
    before = guarded.see(probe)
    for check in probe.dialect.link.checks(built.frame, probe.address):
        for bit in (0, 7):
            changed = bytearray(built.frame)
            changed[check.start] ^= 1 << bit
            sent = probe.send(built.item(bytes(changed)), timeout_ns=PAUSE_NS)
        text = f"{command.name} is executed with a wrong {check.name}"
        _expect_no_effect(probe, guarded, before, sent, text, text)
    _control(probe, command, guarded, values)


def _of_one_length(dialect: Dialect) -> Iterator[Case]:
    """Yield what a dialect whose frames tell their length guards, and its motions."""
    if isinstance(dialect.link, CanLink | LkLink):
        guarded = {command_of(case).name: case for case in _all_guarded(dialect)}
        moves = (Case(dialect, c, {"guarded": _MOTION}) for c in dialect.motions(*_MOTIONS) if c.name not in guarded)
        yield from (*guarded.values(), *moves)


@claim(
    Theme.FRAMING,
    each=_of_one_length,
    name="{command}/other-length",
    refuted_by="an effect of it",
    risks=lambda case: _risks(case) | {Risk.UNKNOWN},
    section=described_in(Subject.FRAMING),
    at_best=Certainty.LIKELY,
    parameters={},
)
def _guarded_by_length(probe: Probe, command: Command, guarded: _Guarded) -> None:
    """{command} with a byte more or less, all else fitting, is not executed."""
    guarded.ready(probe)
    values = guarded.values(probe, command)
    built, link = probe.build(command, values), probe.dialect.link
    head = link.parse(built.frame, probe.address)
    data, form = built.frame[head.start : head.stop], command.request_forms[0]
    before = guarded.see(probe)
    for other in (data[:-1], data + b"\0"):
        frame = link.build(command, form, probe.address, other, Role.REQUEST)
        if other != data and (isinstance(link, LkLink) or len(frame) <= _CAN_BYTES):
            sent = probe.send(built.item(frame), timeout_ns=PAUSE_NS)
            text = f"{command.name} with {len(other)} bytes of data in place of {len(data)} is executed"
            _expect_no_effect(probe, guarded, before, sent, text, f"{command.name}: another length is executed")
    _control(probe, command, guarded, values)


# --- settings ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Stored:
    """A setting that can be read: what sets it to either of two sets of values, and what reads it."""

    command: Command
    form: Form
    values: tuple[Mapping[str, int], Mapping[str, int]]
    read: Callable[[Probe], Mapping[str, int]]


def _every_stored(dialect: Dialect) -> Iterator[_Stored]:
    for command in dialect.commands:
        if command.readable and Risk.LINK not in command.all_risks:
            form = command.request_forms[0]
            yield _Stored(command, form, differing(form), partial(_read, command=command))
        elif command.verb is Verb.WRITE_PARAMETER:
            for form in lk_parameters.listed(command):
                values = lk_parameters.moderate(form, 0), lk_parameters.moderate(form, 1)
                read = partial(lk_parameters.read_parameter, number=lk_parameters.number_of(form))
                yield _Stored(command, form, values, read)


def _read(probe: Probe, command: Command) -> Mapping[str, int]:
    return stored(probe, command)[0]


def _with_settings(dialect: Dialect) -> Iterator[Case]:
    """Yield the settings of a dialect that can be read, all together."""
    chosen = list(_every_stored(dialect))
    if chosen:
        risks = frozenset().union(*(each.command.risks(values) for each in chosen for values in each.values))
        names = (n for each in chosen for n in each.form.layout.named if n != "parameter")
        yield Case(dialect, given={"chosen": chosen}, facts={"risks": risks, "settings": tuple(dict.fromkeys(names))})


@claim(
    Theme.FRAMING,
    each=_with_settings,
    name="settings/guarded",
    refuted_by="a value that is stored",
    section=described_in(Subject.FRAMING),
    quirks=may_meet(lk_parameters.OTHER_FIRMWARE),
    parameters={},
)
def _settings_guarded(probe: Probe, chosen: list[_Stored]) -> None:
    """A setting whose check is wrong is not stored."""
    for each in chosen:
        was = each.read(probe)
        values = next(values for values in each.values if was != values)
        built = probe.build(each.command, values, form=each.form)
        for check in probe.dialect.link.checks(built.frame, probe.address):
            changed = bytearray(built.frame)
            changed[check.start] ^= 1
            sent = probe.send(built.item(bytes(changed)), timeout_ns=PAUSE_NS)
            text = f"{each.command.name} is stored with a wrong {check.name}"
            probe.expect(each.read(probe), equal=was, refutes=text, exchange=sent, key=text)


@_of_guarded(Theme.ADDRESSING, name="other/{command}", section=described_in(Subject.ADDRESSING), alone=True)
def _to_another(probe: Probe, command: Command, guarded: _Guarded) -> None:
    """{command} to another address is not executed."""
    guarded.ready(probe)
    values = guarded.values(probe, command)
    own, (first, last) = probe.address, probe.dialect.addresses
    before = guarded.see(probe)
    # Where an address has a byte and no broadcast, the drive must not hear those that no drive has either.
    bare = probe.dialect.bus == "serial" and probe.dialect.broadcast is None
    byte = (own ^ 0x20, own ^ 0x80, 0xFF) if bare else ()
    near = (a for a in (0, first, own ^ 1, own + 1, last) if a <= last)
    others = [a for a in dict.fromkeys((*near, *byte)) if a not in (own, probe.dialect.broadcast)]
    for address in others:
        sent = probe.send(probe.build(command, values, address=address).item(), timeout_ns=PAUSE_NS)
    text = f"{command.name} to {', '.join(map(str, others))} is executed, and the drive is {own}"
    _expect_no_effect(probe, guarded, before, sent, text, f"{command.name}: another address is executed")
    _control(probe, command, guarded, values)
