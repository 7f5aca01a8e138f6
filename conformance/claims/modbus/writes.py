"""Modbus writes: echoes, refusals, byte counts, and that a write is answered once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.link import WRITE_MANY, WRITE_ONE, ModbusLink
from analyzer.protocols.modbus import ModbusException
from conformance.claim import Inconclusive, Theme
from conformance.claims.control_reads import ask_alone, received_text
from conformance.claims.declare import Case, Cases, claim
from conformance.claims.known_quirks import may_meet
from conformance.claims.modbus.frames import Denied, ask, expect_answer, expect_exceptions, on_modbus, request, unambiguous
from conformance.claims.motion.motion_claim import expect_not_turned, expect_stays, of_motion
from conformance.model import limits
from conformance.motion import declared, motion
from conformance.motion.declared import CALM, QUICK, RUNS_AND_MOVES
from conformance.motion.effects import STEP_NS
from conformance.talk import samples
from conformance.talk.exchange import hex_of
from conformance.talk.probe import MS, Probe

REGISTER_94 = "register-94h"
_ADDRESS, _VALUE = ModbusException.ILLEGAL_DATA_ADDRESS, ModbusException.ILLEGAL_DATA_VALUE
_STANDARD = "8.2; Modbus V1.1b3, 7"
_LATER_MANUAL = "vendor's Modbus manual V1.0.9"
#: A write of several registers that no command has: homing without a switch, as the later manual has it.
_HOME_94 = 0x0094
_HOME_94_DATA = bytes.fromhex("00 00 20 00 00 00 02 58")


# --- what is written --------------------------------------------------------------------------------------------------


def _settings(dialect: Dialect, functions: frozenset[int]) -> tuple[Command, ...]:
    """Return the settings of these functions whose plain values risk nothing but that a setting changes."""
    settings = (c for c in dialect.commands if c.verb.value.startswith("set_") and c.verb is not Verb.SET_ZERO)
    fit = (c for c in settings if c.function in functions and not c.modes)
    return tuple(c for c in fit if c.risks(samples.sample(dialect, c)) == {Risk.SETTING})


def _writes(*functions: frozenset[int]) -> Cases:
    """Return one case with all settings that are written by these functions."""

    def cases(dialect: Dialect) -> Iterator[Case]:
        for case in on_modbus(dialect):
            commands = tuple(c for f in functions for c in _settings(dialect, f))
            fields = tuple(dict.fromkeys(name for c in commands for name in c.request_forms[0].layout.named))
            facts = {"settings": fields, "commands": tuple(c.name for c in commands)}
            yield Case(case.dialect, given={"settings": commands}, facts=facts)

    return cases


_ones, _several, _both = _writes(WRITE_ONE), _writes(WRITE_MANY), _writes(WRITE_ONE, WRITE_MANY)
_none = _writes()


def _of_writes(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"section": "8.2", "risks": {Risk.SETTING}, "parameters": {}, **facts}
    return claim(Theme.MODBUS, each=each, refuted_by=refuted_by, **facts)


def _any_risk(case: Case) -> set[Risk]:
    """Return the risks of settings with a count that is not theirs: it can be read with any values."""
    return {Risk.UNKNOWN}.union(*(c.all_risks for c in case["settings"]))


def _holding(dialect: Dialect) -> Iterator[Case]:
    """Yield the settings that decide how the motor holds the shaft; which values they have matters to no other claim."""
    for case in on_modbus(dialect):
        verbs = (Verb.SET_CURRENT, Verb.SET_HOLDING_CURRENT, Verb.SET_ENABLE_LEVEL, Verb.SET_WORK_MODE)
        commands = tuple(dialect.by_verb[verb] for verb in verbs if verb in dialect.by_verb)
        fields = tuple(name for c in commands for name in c.request_forms[0].layout.named)
        risks = frozenset[Risk]().union(*(c.all_risks for c in commands)) - {Risk.UNKNOWN}
        facts = {"settings": fields, "risks": risks, "commands": tuple(c.name for c in commands)}
        yield Case(case.dialect, given={"settings": commands}, facts=facts)


def _all(dialect: Dialect) -> Iterator[Case]:
    """Yield one case with all of them."""
    for plain, holding in zip(_both(dialect), _holding(dialect), strict=True):
        facts = {name: (*plain.facts[name], *holding.facts[name]) for name in ("settings", "commands")}
        risks = {Risk.SETTING, Risk.UNKNOWN} | holding.facts["risks"]
        yield Case(dialect, given={"settings": (*plain["settings"], *holding["settings"])}, facts=facts | {"risks": risks})


def _plain(probe: Probe, command: Command) -> bytes:
    return probe.build(command, samples.sample(probe.dialect, command)).frame


def _plain_and_edges(probe: Probe, settings: tuple[Command, ...]) -> Iterator[tuple[Command, bytes]]:
    """Yield each setting with plain values, and with each field at its limits where that risks no more."""
    for command in settings:
        form, plain = command.request_forms[0], samples.sample(probe.dialect, command)
        edges = [plain | {n: v} for n, field in form.layout.named.items() for v in limits.edges(field) if field.allows(v)]
        # The plain values come last: they stay.
        for values in (*(each for each in edges if command.risks(each) == command.risks(plain)), plain):
            yield command, probe.build(command, values).frame


# --- echoes -----------------------------------------------------------------------------------------------------------


@_of_writes("other bytes, or silence", each=_ones, name="write_one/echo")
def _echoed(probe: Probe, settings: tuple[Command, ...]) -> None:
    """A write by function 06h is answered by its own bytes, with any values."""
    ask_alone(probe)
    for command, frame in _plain_and_edges(probe, settings):
        expect_answer(probe, ask(probe, frame), frame, f"a write of {command.code:04X}h by 06h")
        probe.wait(probe.rig.write_gap_ns)


@_of_writes("other bytes, or silence", each=_holding, name="write_one/echo-of-current")
def _echoed_of_current(probe: Probe, settings: tuple[Command, ...]) -> None:
    """A write of a current, the En level or the mode is answered by its own bytes, with any values."""
    _echoed(probe, settings)


@_of_writes("other bytes, or silence", each=_several, name="write_many/echo")
def _echoed_shortly(probe: Probe, settings: tuple[Command, ...]) -> None:
    """A write by function 10h is answered by its register and quantity, with any values."""
    ask_alone(probe)
    for command, frame in _plain_and_edges(probe, settings):
        expected = probe.dialect.link.completed(frame[:6])
        expect_answer(probe, ask(probe, frame), expected, f"a write of {command.code:04X}h by 10h")
        probe.wait(probe.rig.write_gap_ns)


# --- refusals ---------------------------------------------------------------------------------------------------------


def _outside(command: Command) -> dict[str, int] | None:
    """Return values of which one is just outside what the manual allows, None where every value is allowed."""
    values = {n: samples.plain_value(f) for n, f in command.request_forms[0].layout.named.items()}
    for name, field in command.request_forms[0].layout.named.items():
        beyond = next((v for v in range(field.high, field.high + 2) if not field.allows(v)), None)
        if field.choices is not None:
            beyond = max(field.choice_names) + 1
        if beyond is not None and beyond <= field.wire_maximum and not field.allows(beyond):
            outside = values | {name: beyond}
            if command.risks(outside) == {Risk.SETTING}:
                return outside
    return None


def _refusals(dialect: Dialect) -> Iterator[Case]:
    """Yield the writes of each function with the end of a refusal by it, and what that is."""
    for name, each, end, function, words in (
        ("write_one", _ones, b"\xff\xff", "06h", "FFFFh in place of the value"),
        ("write_many", _several, b"\0\0", "10h", "a quantity of 0"),
    ):
        for case in each(dialect):
            statement = f"A refused write by function {function} is answered with {words} ({_LATER_MANUAL})."
            facts = dict(case.facts) | {"statement": statement, "name": f"{name}/refused"}
            yield Case(case.dialect, given={**case.given, "end": end}, facts=facts)


# No erratum of this manual says so: the vendor's later one does.
@_of_writes("the echo of a write that was done, an exception, or silence", each=_refusals, at_best=Certainty.LIKELY)
def _refused(probe: Probe, settings: tuple[Command, ...], end: bytes) -> None:
    ask_alone(probe)
    for command in settings:
        values = _outside(command)
        if values is not None:
            frame = probe.build(command, values).frame
            expected = probe.dialect.link.completed(frame[:4] + end)
            expect_answer(probe, ask(probe, frame), expected, f"a value that {command.name} does not have")
            probe.wait(probe.rig.write_gap_ns)


# --- registers --------------------------------------------------------------------------------------------------------


@_of_writes(
    "an echo, or another exception",
    each=_none,
    name="register/unknown_write",
    section=_STANDARD,
    at_best=Certainty.LIKELY,
    risks={Risk.UNKNOWN},
    quirks=may_meet(REGISTER_94),
)
def _unknown_registers(probe: Probe) -> None:
    """A write of a register that no command has is refused by exception 02."""
    ask_alone(probe)
    known = {c.code for c in probe.dialect.commands}
    writes: list[Denied] = []
    for register in sorted({0x0000, 0x00A0, 0x0182, 0x7FFF} - known):
        for function, frame in (
            (0x06, unambiguous(partial(request, probe, 0x06, register))),
            (0x10, unambiguous(partial(_one_register, probe, register))),
        ):
            if frame is not None:
                writes.append((f"a write of register {register:04X}h", function, frame, _ADDRESS))
    if _HOME_94 not in known:
        frame = request(probe, 0x10, _HOME_94, 4, data=b"\x08" + _HOME_94_DATA)
        if ask(probe, frame).received[:4] == frame[:4]:
            probe.meets(REGISTER_94)
        else:
            writes.append(("a write of register 0094h", 0x10, frame, _ADDRESS))
    expect_exceptions(probe, writes)


def _one_register(probe: Probe, register: int, value: int) -> bytes:
    return request(probe, 0x10, register, 1, data=b"\x02" + value.to_bytes(2, "big"))


@_of_writes("an echo", each=_all, name="function/other_write", at_best=Certainty.OPEN)
def _other_function(probe: Probe, settings: tuple[Command, ...]) -> None:
    """A register is written by its own function, 06h or 10h, and not by the other."""
    ask_alone(probe)
    writes: list[Denied] = []
    for command in [c for c in settings if c.function in WRITE_ONE]:
        frame = request(probe, 0x10, command.code, 1, data=b"\x02" + _plain(probe, command)[4:-2])
        writes.append((f"{command.code:04X}h by function 10h", 0x10, frame, _ADDRESS))
    for command in [c for c in settings if c.function in WRITE_MANY]:
        frame = request(probe, 0x06, command.code, 0)
        writes.append((f"{command.code:04X}h by function 06h", 0x06, frame, _ADDRESS))
    expect_exceptions(probe, writes)


# --- motion by other functions than its own write ----------------------------------------------------------------------


def _motions(dialect: Dialect) -> Iterator[Case]:
    for case in on_modbus(dialect):
        for command in dialect.motions(*RUNS_AND_MOVES):
            yield Case(case.dialect, command)


@of_motion(
    theme=Theme.MODBUS,
    each=_motions,
    name="{command}/other_forms",
    refuted_by="a shaft that turns",
    risks={Risk.UNKNOWN},
    at_best=Certainty.LIKELY,
)
def _other_forms(probe: Probe, command: Command) -> None:
    """{command} turns nothing by another function, another quantity or another byte count than its own."""
    motion.prepare(probe, command)
    before = motion.wait_standing(probe)
    values = declared.values_of(probe.dialect, command, 36, acceleration=QUICK, start=motion.place(probe, command))
    frame = probe.build(command, values).frame
    data, own = frame[7:-2], command.quantity
    forms = {
        "function 06h": request(probe, 0x06, command.code, CALM),
        "function 05h": request(probe, 0x05, command.code, 0xFF00),
        "one register fewer": request(probe, 0x10, command.code, own - 1, data=bytes((len(data) - 2,)) + data[:-2]),
        "one register more": request(probe, 0x10, command.code, own + 1, data=bytes((len(data) + 2,)) + data + b"\0\0"),
        "another quantity": request(probe, 0x10, command.code, own + 1, data=bytes((len(data),)) + data),
        "another byte count": request(probe, 0x10, command.code, own, data=bytes((len(data) + 1,)) + data + b"\0"),
        "a byte count that is too small": request(probe, 0x10, command.code, own, data=bytes((len(data) - 1,)) + data[:-1]),
    }
    for what, sent_frame in forms.items():
        sent = probe.send(sent_frame, timeout_ns=_BETWEEN_NS)
        expect_not_turned(probe, before, sent, f"{command.name} is executed with {what}")
    probe.wait(_WATCH_NS)
    expect_stays(before, motion.position(probe), sent, f"{command.name} is executed in another form")


#: How long is listened to a form that is to do nothing, and how long the shaft is watched behind all.
_BETWEEN_NS, _WATCH_NS = 60 * MS, 300 * MS


@claim(
    Theme.MODBUS,
    each=lambda dialect: [Case(dialect, dialect.by_verb[Verb.ENABLE]) for _ in on_modbus(dialect)],
    name="{command}/other_forms",
    refuted_by="a motor that is off",
    risks=lambda case: declared.risks(case.dialect, Risk.UNKNOWN, Risk.TORQUE),
    settings=lambda case: declared.settings(case.dialect),
    at_best=Certainty.LIKELY,
)
def _not_disabled(probe: Probe, command: Command) -> None:
    """A write of register 00F3h by 10h, or with a quantity, does not switch the motor off."""
    motion.ready_to_move(probe)
    for frame in (
        request(probe, 0x10, command.code, 1, data=b"\x02\0\0"),
        request(probe, 0x10, command.code, 2, data=b"\x04\0\0\0\0"),
        request(probe, 0x05, command.code, 0),
    ):
        sent = probe.send(frame, timeout_ns=_BETWEEN_NS)
        text = "the motor is switched off by another function than 06h"
        probe.expect("off", holds=motion.is_on(probe) is not False, expected="on", refutes=text, exchange=sent)


# --- byte counts ------------------------------------------------------------------------------------------------------


def _odd_counts(dialect: Dialect) -> Mapping[int, int]:
    return dialect.link.odd_counts if isinstance(dialect.link, ModbusLink) else {}


def _odd(dialect: Dialect) -> Iterator[Case]:
    counts = _odd_counts(dialect)
    if counts:
        listed = ", ".join(f"{register:04X}h" for register in counts)
        statement = f"Register {listed} is written with the byte count that is printed, and no other."
        for case in _several(dialect):
            yield Case(case.dialect, given=case.given, facts=dict(case.facts) | {"statement": statement})


@_of_writes(
    "a refusal of the printed count, or another answer than exception 03 to another",
    each=_odd,
    name="byte_count/odd",
    section="8.2.20",
    rests_on=(Doubt.LAYOUT,),
    about=("set_home",),
    risks=_any_risk,
)
def _odd_byte_count(probe: Probe, settings: tuple[Command, ...]) -> None:
    ask_alone(probe)
    for register, count in _odd_counts(probe.dialect).items():
        for command in (c for c in settings if c.code == register):
            data, even = _plain(probe, command)[7:-2], 2 * command.quantity
            frame = request(probe, 0x10, register, command.quantity, data=bytes((count,)) + data)
            echo = probe.dialect.link.completed(frame[:6])
            expect_answer(probe, ask(probe, frame), echo, f"register {register:04X}h with {count} bytes")
            frame = request(probe, 0x10, register, command.quantity, data=bytes((even,)) + data.ljust(even, b"\0"))
            expect_exceptions(probe, [(f"register {register:04X}h with {even} bytes", 0x10, frame, _VALUE)])


@_of_writes(
    "an echo, or another exception",
    each=_several,
    name="byte_count/others",
    section=_STANDARD,
    at_best=Certainty.LIKELY,
    risks=_any_risk,
)
def _other_byte_counts(probe: Probe, settings: tuple[Command, ...]) -> None:
    """A write by 10h with another quantity or byte count than its register's is refused by exception 03."""
    ask_alone(probe)
    writes: list[Denied] = []
    for command in settings:
        data, own = _plain(probe, command)[7:-2], command.quantity
        for quantity, wrong in ((own, data[:-1]), (own, data + b"\0"), (own + 1, data + b"\0\0"), (own - 1, data[:-2])):
            if quantity == own and len(wrong) == 2 * quantity:
                continue
            frame = request(probe, 0x10, command.code, quantity, data=bytes((len(wrong),)) + wrong)
            what = f"{quantity} registers in {len(wrong)} bytes to {command.code:04X}h, which has {own}"
            writes.append((what, 0x10, frame, _VALUE))
    expect_exceptions(probe, writes)


# --- moves ------------------------------------------------------------------------------------------------------------

_STEP: Mapping[str, int] = {"speed": 60, "acceleration": 200, "position": 400}


def _moves(dialect: Dialect) -> Iterator[Case]:
    for case in on_modbus(dialect):
        if declared.can_move(dialect):
            yield Case(case.dialect, dialect.by_verb[Verb.MOVE_RELATIVE_AXIS])


@claim(
    Theme.MODBUS,
    each=_moves,
    name="write_many/once",
    refuted_by="a second frame when the move is done",
    risks=lambda case: declared.risks(case.dialect),
    settings=lambda case: declared.settings(case.dialect),
)
def _answered_once(probe: Probe, command: Command) -> None:
    """A move is answered once, when it begins; that it is done has to be asked for."""
    ask_alone(probe)
    motion.ready_to_move(probe)
    before = probe.read(Verb.READ_POSITION, "position")
    frame = probe.build(command, _STEP).frame
    sent = probe.send(frame, timeout_ns=STEP_NS)
    if probe.read(Verb.READ_POSITION, "position") == before or not sent.received:
        raise Inconclusive("the shaft did not move")
    echo = probe.dialect.link.completed(frame[:6])
    probe.expect(
        received_text(sent),
        holds=sent.received == echo,
        expected=f"{hex_of(echo)} and nothing more to {hex_of(frame)}",
        refutes="a move is not answered once, by its echo",
        exchange=sent,
    )
