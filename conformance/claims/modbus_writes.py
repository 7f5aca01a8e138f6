"""Modbus writes: echoes, refusals, byte counts, and that a write is answered once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.link import WRITE_MANY, WRITE_ONE, ModbusLink
from analyzer.protocols.modbus import ModbusException
from conformance.claim import Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.hearing import ask_cleanly, came
from conformance.claims.known_quirks import known
from conformance.claims.modbus_frames import ask, exception, judge, request
from conformance.motion import motion
from conformance.motion.effects import STEP_NS
from conformance.talk import samples
from conformance.talk.exchange import hex_of

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

REGISTER_94 = "register-94h"
_LATER_MANUAL = "vendor's Modbus manual V1.0.9"
#: What the refused forms rest on: no erratum of this manual, the vendor's later one.
_REFUSAL = Certainty.LIKELY
#: A write of several registers that no command has: homing without a switch, as the later manual has it.
_HOME_94 = 0x0094
_HOME_94_DATA = bytes.fromhex("00 00 20 00 00 00 02 58")


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about writes."""
    ones, several = _harmless(dialect, WRITE_ONE), _harmless(dialect, WRITE_MANY)
    yield _echoed_one(dialect, ones)
    yield _echoed_several(dialect, several)
    yield _refused(dialect, "write_one", ones)
    yield _refused(dialect, "write_many", several)
    yield _unknown_registers(dialect)
    yield from _counts(dialect, several)
    yield from _other_function(dialect, ones, several)
    if motion.can_move(dialect):
        yield _answered_once(dialect)


def _harmless(dialect: Dialect, functions: frozenset[int]) -> list[Command]:
    """Return the settings of these functions whose plain values risk nothing but that a setting changes."""
    settings = (c for c in dialect.commands if c.verb.value.startswith("set_") and c.verb is not Verb.SET_ZERO)
    fit = (c for c in settings if c.function in functions and not c.modes)
    return [c for c in fit if c.risks(samples.sample(dialect, c)) == {Risk.SETTING}]


def _fields(commands: list[Command]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for c in commands for name in c.request_forms[0].layout.named))


def _make(
    dialect: Dialect, name: str, statement: str, refuted_by: str, check: Any, commands: list[Command], **rest: Any
) -> Claim:
    rest.setdefault("risks", {Risk.SETTING})
    section = rest.pop("section", "8.2")
    named = tuple(c.name for c in commands)
    fields = _fields(commands)
    return declare(
        dialect, Theme.MODBUS, name, statement, refuted_by, check, section=section, settings=fields, commands=named, **rest
    )


# --- echoes -----------------------------------------------------------------------------------------------------------


def _echoed_one(dialect: Dialect, commands: list[Command]) -> Claim:
    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        for command in commands:
            frame = probe.build(command, samples.sample(dialect, command)).frame
            judge(probe, ask(probe, frame), frame, f"a write of {command.code:04X}h by 06h")
            probe.wait(probe.rig.write_gap_ns)

    statement = "A write by function 06h is answered by its own bytes."
    return _make(dialect, "write_one/echo", statement, "other bytes, or silence", check, commands)


def _echoed_several(dialect: Dialect, commands: list[Command]) -> Claim:
    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        for command in commands:
            frame = probe.build(command, samples.sample(dialect, command)).frame
            expected = dialect.link.completed(frame[:6])
            judge(probe, ask(probe, frame), expected, f"a write of {command.code:04X}h by 10h")
            probe.wait(probe.rig.write_gap_ns)

    statement = "A write by function 10h is answered by its register and quantity."
    return _make(dialect, "write_many/echo", statement, "other bytes, or silence", check, commands)


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


#: Function by which a write is refused: the last two bytes of the refusal, and what they are.
_REFUSALS = {
    "write_one": (b"\xff\xff", "06h", "FFFFh in place of the value"),
    "write_many": (b"\0\0", "10h", "a quantity of 0"),
}


def _refused(dialect: Dialect, name: str, commands: list[Command]) -> Claim:
    end, function, words = _REFUSALS[name]

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        for command in commands:
            values = _outside(command)
            if values is not None:
                frame = probe.build(command, values).frame
                expected = dialect.link.completed(frame[:4] + end)
                judge(probe, ask(probe, frame), expected, f"a value that {command.name} does not have")
                probe.wait(probe.rig.write_gap_ns)

    statement = f"A refused write by function {function} is answered with {words} ({_LATER_MANUAL})."
    refuted_by = "the echo of a write that was done, an exception, or silence"
    return _make(dialect, f"{name}/refused", statement, refuted_by, check, commands, at_best=_REFUSAL)


# --- registers --------------------------------------------------------------------------------------------------------


def _unknown_registers(dialect: Dialect) -> Claim:
    quirks = known(dialect, REGISTER_94)

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        known = {c.code for c in dialect.commands}
        refused = ModbusException.ILLEGAL_DATA_ADDRESS
        for register in sorted({0x0000, 0x00A0, 0x0182, 0x7FFF} - known):
            frame = request(probe, 0x06, register, 0x0000)
            judge(probe, ask(probe, frame), exception(probe, 0x06, refused), f"a write of register {register:04X}h")
            frame = request(probe, 0x10, register, 1, data=b"\x02\0\0")
            judge(probe, ask(probe, frame), exception(probe, 0x10, refused), f"a write of register {register:04X}h")
        if _HOME_94 in known:
            return
        frame = request(probe, 0x10, _HOME_94, 4, data=b"\x08" + _HOME_94_DATA)
        sent = ask(probe, frame)
        if sent.received[:4] == frame[:4]:
            probe.meets(REGISTER_94)
            return
        judge(probe, sent, exception(probe, 0x10, refused), "a write of register 0094h")

    return _make(
        dialect, "register/unknown_write", "A write of a register that no command has is refused by exception 02.",
        "silence, an echo, or another exception", check, [], section="8.2; Modbus V1.1b3, 7", at_best=Certainty.LIKELY,
        risks={Risk.UNKNOWN}, quirks=quirks,
    )  # fmt: skip


# --- byte counts ------------------------------------------------------------------------------------------------------


def _counts(dialect: Dialect, commands: list[Command]) -> Iterator[Claim]:
    link = dialect.link
    assert isinstance(link, ModbusLink)  # asked by the theme
    refused = ModbusException.ILLEGAL_DATA_VALUE
    # A count that is not the register's can be read with any values.
    risks = {Risk.UNKNOWN}.union(*(c.all_risks for c in commands))

    def odd(probe: Probe) -> None:
        ask_cleanly(probe)
        for register, count in link.odd_counts.items():
            for command in (c for c in commands if c.code == register):
                data = probe.build(command, samples.sample(dialect, command)).frame[7:-2]
                frame = request(probe, 0x10, register, command.quantity, data=bytes((count,)) + data)
                judge(probe, ask(probe, frame), link.completed(frame[:6]), f"register {register:04X}h with {count} bytes")
                wrong = 2 * command.quantity
                frame = request(probe, 0x10, register, command.quantity, data=bytes((wrong,)) + data.ljust(wrong, b"\0"))
                what = f"register {register:04X}h with {wrong} bytes"
                judge(probe, ask(probe, frame), exception(probe, 0x10, refused), what)

    def others(probe: Probe) -> None:
        ask_cleanly(probe)
        for command in commands:
            data = probe.build(command, samples.sample(dialect, command)).frame[7:-2]
            for quantity, own in ((command.quantity, data[:-1]), (command.quantity, data + b"\0"),
                                  (command.quantity + 1, data + b"\0\0"), (command.quantity - 1, data[:-2])):  # fmt: skip
                if quantity == command.quantity and len(own) == 2 * quantity:
                    continue
                frame = request(probe, 0x10, command.code, quantity, data=bytes((len(own),)) + own)
                what = f"{quantity} registers in {len(own)} bytes to {command.code:04X}h, which has {command.quantity}"
                judge(probe, ask(probe, frame), exception(probe, 0x10, refused), what)

    if link.odd_counts:
        listed = ", ".join(f"{r:04X}h" for r in link.odd_counts)
        yield _make(
            dialect, "byte_count/odd", f"Register {listed} is written with the byte count that is printed, and no other.",
            "a refusal of the printed count, or anything but exception 03 to another", odd, commands,
            section="8.2.20", rests_on=(Doubt.LAYOUT,), about=("set_home",), risks=risks,
        )  # fmt: skip
    yield _make(
        dialect, "byte_count/others", "A write by 10h with another quantity or byte count than its register's is refused"
        " by exception 03.", "an echo, silence, or another exception", others, commands, section="8.2; Modbus V1.1b3, 7",
        at_best=Certainty.LIKELY, risks=risks,
    )  # fmt: skip


def _other_function(dialect: Dialect, ones: list[Command], several: list[Command]) -> Iterator[Claim]:
    refused = ModbusException.ILLEGAL_DATA_ADDRESS

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        for command in ones[:2]:
            data = probe.build(command, samples.sample(dialect, command)).frame[4:-2]
            frame = request(probe, 0x10, command.code, 1, data=b"\x02" + data)
            judge(probe, ask(probe, frame), exception(probe, 0x10, refused), f"{command.code:04X}h by function 10h")
        for command in several[:2]:
            frame = request(probe, 0x06, command.code, 0)
            judge(probe, ask(probe, frame), exception(probe, 0x06, refused), f"{command.code:04X}h by function 06h")

    yield _make(
        dialect, "function/other_write", "A register is written by its own function, 06h or 10h, and not by the other.",
        "an echo", check, [*ones, *several], at_best=Certainty.OPEN, risks={Risk.SETTING, Risk.UNKNOWN},
    )  # fmt: skip


# --- moves ------------------------------------------------------------------------------------------------------------

_STEP: Mapping[str, int] = {"speed": 60, "acceleration": 200, "position": 400}


def _answered_once(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.MOVE_RELATIVE_AXIS]

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        motion.ready_to_move(probe)
        before = probe.read(Verb.READ_POSITION, "position")
        frame = probe.build(command, _STEP).frame
        sent = probe.send(frame, timeout_ns=STEP_NS)
        if probe.read(Verb.READ_POSITION, "position") == before or not sent.received:
            raise Inconclusive("the shaft did not move")
        if sent.received != dialect.link.completed(frame[:6]):
            raise Refuted(
                "a move is not answered once, by its echo",
                expected=f"{hex_of(dialect.link.completed(frame[:6]))} and nothing more to {hex_of(frame)}",
                got=came(sent),
                exchange=sent,
            )

    return declare(
        dialect,
        Theme.MODBUS,
        "write_many/once",
        "A move is answered once, when it begins; that it is done has to be asked for.",
        "a second frame when the move is done",
        check,
        command=command,
        risks=motion.risks(dialect),
        settings=motion.settings(dialect),
    )
