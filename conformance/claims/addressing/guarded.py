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
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Role, Subject, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS
from conformance.claim import Inconclusive, Theme
from conformance.claims import bench
from conformance.claims.control_reads import PAUSE_NS, expect_silence
from conformance.claims.declare import Case, claim, described_in
from conformance.claims.known_quirks import may_meet
from conformance.claims.known_reads import every_read, is_stored, plain_reads
from conformance.claims.motion.motion_claim import command_of
from conformance.claims.motion.protection import protect
from conformance.claims.settings import setting_effects
from conformance.claims.settings.known_settings import ReadableSetting, needs, readable_settings
from conformance.model import lk_parameters
from conformance.motion import arriving, motion
from conformance.motion.motion import MOVES, MS, SAME
from conformance.talk import restarts
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe

#: A motion that shows: degrees, and rpm where it can be told.
_DEGREES, _RPM = 20, 30
#: How far a shaft is brought away from zero (deg).
_OFF_ZERO = 36
#: How long a motion that is executed has until it is looked for; a shaft that went less than `_STILL` (deg) stays.
_WATCH_NS, _STILL = 150 * MS, 4 * SAME
_POWER_OFF, _RELEASED, _READ_BRAKE = 0x00, 0x01, 0x10
_POSITION_STEP = 4_321
#: A position beyond three turns, the status of a calibration, and what lets a port be written.
_TURNS_AWAY, _CALIBRATING, _WRITE = 123_400, 6, 1
#: The shorter way back to a kept zero, at the highest speed.
_NEAR, _FASTEST = 2, 4


def _switch_on(probe: Probe) -> object:
    return motion.switch(probe, True)


@dataclass(frozen=True)
class Guarded:
    """A command that must not be executed. `ready`: makes it tell; `values`: what is sent; `see`: what it would change.

    `within`: by how much that differs by itself. `after`: puts back what it changed. `again`: sent whole, it shows; what ends a
    connection or takes long is sent whole by other claims alone. `sends`: what `see` sends beside motion.
    """

    ready: Callable[[Probe], object]
    values: Callable[[Probe, Command], Mapping[str, int]]
    see: Callable[[Probe], float]
    within: float = 0.0
    after: Callable[[Probe], object] = _switch_on
    again: bool = True
    sends: tuple[Verb, ...] = ()

    def shows(self, probe: Probe, before: float, after: float) -> bool:
        """Say whether what is seen has changed by more than it does by itself: a place trembles, and nothing else does."""
        return abs(after - before) > self.within + (probe.noise.place if self.within else 0.0)


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
    # Far from the old position and from the ends of 32 bits.
    return {"position": _POSITION_STEP if abs(now - _POSITION_STEP) > _POSITION_STEP // 2 else -_POSITION_STEP}


def _away(probe: Probe) -> None:
    """Bring the shaft away from zero: what makes its place zero then shows."""
    motion.ready_to_move(probe)
    at = motion.position(probe).value
    arriving.follow(probe, motion.any_move(probe.dialect), _OFF_ZERO if at > -_OFF_ZERO / 2 else -_OFF_ZERO)


def _turn(probe: Probe) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, -_RPM)
    probe.wait(_WATCH_NS)


def _turns(probe: Probe) -> float:
    return float(abs(motion.speed(probe).value) > _RPM / 2)


def _turns_still(probe: Probe) -> float:
    """Say whether the shaft turns, of a drive that may just have begun anew."""
    restarts.wait_for_answer(probe)
    return _turns(probe)


def _count_turns(probe: Probe) -> None:
    motion.ready_to_move(probe)
    probe.do("set_position", {"position": _TURNS_AWAY})


def _calibrates(probe: Probe) -> float:
    return float(probe.read(Verb.READ_STATUS, "status") == _CALIBRATING)


def _has_flag(probe: Probe) -> float:
    return float(any(probe.read(Verb.READ_STATE_1, field.name) for field in ERROR_BITS))


def _set_flag(probe: Probe) -> None:
    for present in (True, False):
        bench.lk_drive(probe).trip("overcurrent", present)


def _clear_flag(probe: Probe) -> object:
    return probe.do(Verb.CLEAR_ERRORS)


def _protected(probe: Probe) -> float:
    return probe.read(Verb.READ_PROTECTION, "status")


def _ports(probe: Probe) -> float:
    return 2 * probe.read(Verb.READ_IO, "alm") + probe.read(Verb.READ_IO, "pend")


def _other_ports(probe: Probe, command: Command) -> Mapping[str, int]:
    now = int(_ports(probe))
    return {"alm_mask": _WRITE, "pend_mask": _WRITE, "alm": 1 - now // 2, "pend": 1 - now % 2}


def _own_ports(probe: Probe) -> object:
    return probe.do(Verb.WRITE_IO, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})


def _pulse_mode(probe: Probe, command: Command) -> Mapping[str, int]:
    modes = motion.field_of(command, "work_mode").choice_names
    return {"work_mode": next(value for value, name in modes.items() if name not in motion.bus_modes(probe.dialect))}


def _moves_by_bus(probe: Probe) -> float:
    """Say whether the motor can be enabled, as in a bus mode alone."""
    return float(not motion.refused(probe, probe.ask(Verb.ENABLE, {"enabled": 1})))


def _another_group(probe: Probe) -> int:
    return next(group for group in setting_effects.GROUPS[2:] if group not in (probe.address, probe.rig.group))


def _is_in_another_group(probe: Probe) -> float:
    return float(setting_effects.hears(probe, _another_group(probe)))


def _forget_zero(probe: Probe) -> object:
    return probe.do(Verb.SET_ZERO_MODE, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})


def _without_zero(probe: Probe) -> None:
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    _forget_zero(probe)


def _goes_back(probe: Probe) -> float:
    """Bring the shaft away, restart, and return how far it is then from where it was left, in degrees within the turn."""
    motion.ready_to_move(probe)
    arriving.follow(probe, motion.any_move(probe.dialect), _OFF_ZERO)
    left = probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    restarts.restart(probe)
    motion.wait_standing(probe)
    turn = probe.dialect.counts_per_turn
    went = (probe.read(Verb.READ_ENCODER_CARRY, "encoder") - left) % turn
    return min(went, turn - went) * 360 / turn


def _halt(probe: Probe) -> object:
    return probe.ask(Verb.EMERGENCY_STOP)


_MOTION = Guarded(motion.ready_to_move, _motion_values, _shaft, _STILL)
#: What switches, renames or homes, by the name of the command.
_SWITCHES: Mapping[str, Guarded] = {
    "enable": Guarded(motion.ready_to_move, lambda probe, command: {"enabled": 0}, _is_on),
    # With what a user has set it may end at once: then it makes zero where the shaft stands.
    "home": Guarded(_away, _nothing, _shaft, _STILL, after=_halt),
    "motor_off": Guarded(_switch_on, _nothing, _is_on),
    "motor_on": Guarded(partial(motion.switch, on=False), _nothing, _is_on),
    "brake": Guarded(_release, lambda probe, command: {"brake_control": _POWER_OFF}, _brake, after=_release),
    "set_position": Guarded(motion.ready_to_move, _another_position, _shaft, _STILL),
}
_STOP = Guarded(_turn, lambda probe, command: {"acceleration": motion.QUICK} if motion.of(command).acceleration else {}, _turns)
_NEW_BEGINNING = Guarded(_turn, _nothing, _turns_still, after=motion.ready_to_move, again=False)
#: What stops a shaft, and what shows beside: on buses alone whose frames tell their length. `facts` of their claims.
_MORE: Mapping[str, tuple[Guarded, Mapping[str, Any]]] = {
    "emergency_stop": (_STOP, {}),
    "stop_speed": (_STOP, {}),
    "stop": (_STOP, {}),
    "restart": (_NEW_BEGINNING, {}),
    "restore": (_NEW_BEGINNING, {"alone": True}),
    "calibrate": (Guarded(motion.ready_to_move, _nothing, _calibrates, after=_halt, again=False), {"by_name": True}),
    "write_io": (Guarded(motion.ready_to_move, _other_ports, _ports, after=_own_ports), {}),
    "release_protection": (Guarded(protect, _nothing, _protected), {"emulated": True, "settings": ("protection",)}),
    "clear_errors": (Guarded(_set_flag, _nothing, _has_flag, after=_clear_flag), {"emulated": True}),
    "clear_turns": (Guarded(_count_turns, _nothing, _shaft, _STILL), {}),
}
#: What else several drives are told at once.
_TO_MANY: Mapping[str, tuple[Guarded, Mapping[str, Any]]] = {
    **{name: _MORE[name] for name in ("calibrate", "write_io", "release_protection")},
    "set_work_mode": (Guarded(motion.ready_to_move, _pulse_mode, _moves_by_bus, after=motion.ready_to_move), {}),
    "set_group_address": (
        Guarded(
            motion.ready_to_move,
            lambda probe, command: {"group_address": _another_group(probe)},
            _is_in_another_group,
            sends=(Verb.ENABLE,),
        ),
        {"settings": ("group_address",)},
    ),
    "set_zero_mode": (
        Guarded(
            _without_zero,
            lambda probe, command: {"zero_mode": _NEAR, "set_zero": 1, "zero_speed": _FASTEST, "zero_direction": 0},
            _goes_back,
            _OFF_ZERO / 2,
            after=_forget_zero,
            sends=(Verb.RESTART,),
        ),
        {"settings": ("zero_mode", "set_zero", "zero_speed", "zero_direction")},
    ),
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
        zero = Guarded(_away, _nothing, _shaft, _STILL, after=motion.ready_to_move)
        yield Case(dialect, dialect.by_verb[Verb.SET_ZERO], {"guarded": zero})


def risks(case: Case) -> frozenset[Risk]:
    """Return what a claim about a guarded command may do."""
    command = command_of(case)
    switching = {Risk.TORQUE} if command.verb is Verb.MOTOR_ON else set[Risk]()
    run = case.dialect.by_verb.get(Verb.RUN_SPEED)
    if run is not None and case["guarded"].ready is _turn:
        switching |= run.all_risks - {Risk.UNKNOWN}
    switching |= {risk for verb in case["guarded"].sends for risk in case.dialect.by_verb[verb].all_risks - {Risk.UNKNOWN}}
    # A damaged frame with a head may be read as another one, where nothing tells its length.
    if case.dialect.link.first_bytes and not case.dialect.link.tells_length:
        switching.add(Risk.UNKNOWN)
    return motion.risks(case.dialect, *(command.all_risks - {Risk.UNKNOWN}), *switching)


def switches(dialect: Dialect) -> Iterator[Case]:
    """Yield what switches, homes, sets the zero or writes a port of the drives that hear several addresses."""
    if dialect.broadcast is not None:
        yield from (case for case in _all_guarded(dialect) if case["guarded"] is not _MOTION)
        yield from _of_table(dialect, _TO_MANY)


def _of_table(dialect: Dialect, table: Mapping[str, tuple[Guarded, Mapping[str, Any]]]) -> Iterator[Case]:
    for name, (guarded, facts) in table.items():
        if name in dialect.by_name and motion.can_move(dialect):
            settings = motion.settings(dialect, *facts.get("settings", ()))
            yield Case(dialect, dialect.by_name[name], {"guarded": guarded}, {**facts, "settings": settings})


def _every_guarded(dialect: Dialect) -> Iterator[Case]:
    """Yield them with what stops, clears or begins anew, on buses whose frames tell their length."""
    yield from _all_guarded(dialect)
    yield from _of_table(dialect, _MORE if dialect.link.tells_length else {})


def _repeatable(dialect: Dialect) -> Iterator[Case]:
    return (case for case in _every_guarded(dialect) if case["guarded"].again)


_of_guarded = partial(claim, refuted_by="an effect of it", risks=risks, parameters={})
_of_framing = partial(claim, Theme.FRAMING, section=described_in(Subject.FRAMING), parameters={})


def _expect_no_effect(probe: Probe, guarded: Guarded, before: float, sent: Exchange, refutes: str, key: str) -> None:
    probe.wait(_WATCH_NS)
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
    probe.wait(_WATCH_NS)
    after = guarded.see(probe)
    leave(probe, guarded)
    if not guarded.shows(probe, before, after):
        raise Inconclusive(f"{command.name} shows no effect when it is sent whole either")


def leave(probe: Probe, guarded: Guarded) -> None:
    """Leave the motor on and the shaft at rest."""
    guarded.after(probe)
    motion.stand_still(probe)


@_of_guarded(Theme.FRAMING, each=_every_guarded, name="{command}/guarded", section=described_in(Subject.FRAMING))
def _guarded_by_sums(probe: Probe, command: Command, guarded: Guarded) -> None:
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
        built = probe.build(command)
        for check in probe.dialect.link.checks(built.frame, probe.address):
            changed = bytearray(built.frame)
            changed[check.start] ^= 1
            sent = probe.send(built.item(bytes(changed)), timeout_ns=PAUSE_NS)
            expect_silence(probe, sent, f"{command.name} is answered with a wrong {check.name}")


def _of_one_length(dialect: Dialect) -> Iterator[Case]:
    """Yield what a dialect whose frames tell their length guards and can be sent again, and its motions."""
    if dialect.link.tells_length:
        guarded = {command_of(case).name: case for case in _repeatable(dialect)}
        moves = (Case(dialect, c, {"guarded": _MOTION}) for c in dialect.motions(*_MOTIONS) if c.name not in guarded)
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
        built = probe.build(each.command, values, form=each.form)
        for check in probe.dialect.link.checks(built.frame, probe.address):
            changed = bytearray(built.frame)
            changed[check.start] ^= 1
            sent = probe.send(built.item(bytes(changed)), timeout_ns=PAUSE_NS)
            text = f"{each.command.name} is stored with a wrong {check.name}"
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
_SHORT_NS = 20 * motion.MS
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
    if chosen and motion.can_move(dialect):
        commands = [
            *(each.command for each in chosen),
            *(dialect.by_name[n] for n, _ in deeds),
            dialect.by_verb[Verb.RUN_SPEED],
        ]
        risks = frozenset[Risk]().union(*(c.all_risks for c in commands)) - {Risk.UNKNOWN}
        _, names = needs(chosen)
        facts = {"risks": motion.risks(dialect, *risks), "settings": motion.settings(dialect, *names)}
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
    _expect_kept(probe, kept, "a run", motion.run_at(probe, _RPM))
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


@_of_guarded(Theme.ADDRESSING, each=_repeatable, name="other/{command}", section=described_in(Subject.ADDRESSING), alone=True)
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
