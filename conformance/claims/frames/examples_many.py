"""Worked examples to several drives: to all of them, to a group, and packages. Executed, never answered.

FA 00 FD 01 2C 64 00 00 0C 80 14     "motor 1-6 will rotate a turn"
FA 50 FD 01 2C 64 00 00 0C 80 64     "motor 1-3 will rotate a turn", whose group address is 50h
FC 01 F6 00 32 0A ..                 "motor 1 rotates forward continuously"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from analyzer import encoder
from analyzer.catalogue import Command, Dialect, Role, Vector, Verb
from analyzer.decoder import slots_of
from conformance.claim import Aspect, Inconclusive, Theme
from conformance.claims.control_reads import expect_silence
from conformance.claims.declare import Case, claim
from conformance.motion import declared, motion
from conformance.motion.declared import SUBDIVISION
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import MS, SECOND_NS, Probe

#: How long the examples are looked at: they turn the shaft at 300 rpm and less.
_MOVE_NS = 1500 * MS
#: Degrees after which a move counts as one.
_MOVED = 90.0


def is_to_many(dialect: Dialect, command: Command, vector: Vector) -> bool:
    """Say whether a printed request is to all drives, or to a group."""
    return _group(dialect, command, vector) or _address(dialect, vector) == dialect.broadcast


def _address(dialect: Dialect, vector: Vector) -> int:
    can_id, data = vector.taken_on(dialect.bus)
    return dialect.link.parse(data, can_id).address


def _group(dialect: Dialect, command: Command, vector: Vector) -> bool:
    setting = dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
    address = _address(dialect, vector)
    return setting is not None and vector.section == setting.section and address not in (1, dialect.broadcast)


# --- to all drives, and to a group ------------------------------------------------------------------------------------


def _requests(command: Command) -> list[Vector]:
    return [v for v in command.vectors if v.role is Role.REQUEST]


def _to_many(dialect: Dialect) -> Iterator[Case]:
    setting = dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
    for command in dialect.commands:
        vectors = [v for v in _requests(command) if command.slots is None and is_to_many(dialect, command, v)]
        for number, vector in enumerate(vectors, 1):
            grouped = setting is not None and _group(dialect, command, vector)
            risks = set(encoder.assemble(dialect, command, 1, vector.values).risks) | declared.risks(dialect)
            facts = {
                "name": f"{{command}}/to_{'group' if grouped else 'all'}_{number}",
                "section": vector.section,
                "risks": risks | (setting.all_risks if setting is not None and grouped else set()),
                "settings": declared.settings(dialect, *(("group_address",) if grouped else ())),
                "parameters": {"printed": vector.printed},
            }
            yield Case(dialect, command, {"vector": vector, "grouped": grouped, "printed": vector.printed}, facts)


@claim(Theme.EXAMPLES, each=_to_many, refuted_by="an answer, or no move", aspect=Aspect.EXAMPLE, alone=True)
def _turns(probe: Probe, command: Command, vector: Vector, grouped: bool) -> None:
    """The printed request {printed} turns the motor and is not answered."""
    to = _address(probe.dialect, vector)
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    if grouped:
        probe.do(Verb.SET_GROUP_ADDRESS, {"group_address": to})
    before = motion.position(probe).value
    sent = probe.send(probe.build(command, vector.values, address=to).item(), timeout_ns=_MOVE_NS)
    moved = motion.position(probe).value - before
    _judge(probe, sent, moved, lambda: _moves_alone(probe, command, vector))


def _moves_alone(probe: Probe, command: Command, vector: Vector) -> bool:
    """Say whether the drive moves by the same request to itself."""
    before = motion.position(probe).value
    probe.ask(command, vector.values)
    probe.wait(_MOVE_NS)
    return abs(motion.position(probe).value - before) >= _MOVED


def _runs_alone(probe: Probe) -> bool:
    """Say whether the drive is seen to run when it is told so by itself."""
    before = motion.position(probe).value
    motion.run_at(probe, 60)
    probe.wait(SECOND_NS)
    moved = motion.position(probe).value - before
    motion.stop(probe)
    probe.wait(SECOND_NS)
    return abs(moved) >= _MOVED


def _judge(probe: Probe, sent: Exchange, moved: float, moves_alone: Callable[[], bool]) -> None:
    what = hex_of(sent.sent or b"")
    expect_silence(probe, sent, "the example is answered")
    if abs(moved) < _MOVED:
        if not moves_alone():
            raise Inconclusive("no move can be seen when the drive is told by itself either")
        text = "the example does not turn the motor"
        probe.expect(f"{moved:.1f} degrees", holds=False, expected=f"a move after {what}", refutes=text, exchange=sent)


# --- packages ---------------------------------------------------------------------------------------------------------


def _packages(dialect: Dialect) -> Iterator[Case]:
    for command in dialect.commands:
        # A package that is printed again with an erratum is the same one as corrected.
        frames: dict[str, Vector] = {}
        for vector in _requests(command) if command.slots is not None else ():
            frames.setdefault(vector.corrected or vector.printed, vector)
        for number, (printed, vector) in enumerate(frames.items(), 1):
            data = bytes.fromhex(printed)
            slots = slots_of(dialect, command, data[1:-1])
            risks = declared.risks(dialect).union(*(slot.command.all_risks for slot in slots if slot.command is not None))
            facts = {
                "name": f"{{command}}/{number}",
                "section": vector.section,
                "errata": (vector.erratum,) if vector.erratum else (),
                "risks": risks,
                "settings": declared.settings(dialect),
                "parameters": {"printed": vector.printed},
            }
            yield Case(dialect, command, {"data": data, "used": len(slots)}, facts)


@claim(Theme.EXAMPLES, each=_packages, refuted_by="an answer, or no run", aspect=Aspect.EXAMPLE, alone=True)
def _package(probe: Probe, command: Command, data: bytes, used: int) -> None:
    """The printed package makes its first drive run at a speed, and is not answered."""
    motion.ready_to_move(probe)
    before = motion.position(probe).value
    sent = probe.send(_addressed(probe, command, data, used), timeout_ns=_MOVE_NS)
    moved = motion.position(probe).value - before
    motion.stop(probe)
    probe.wait(SECOND_NS)
    _judge(probe, sent, moved, lambda: _runs_alone(probe))


def _addressed(probe: Probe, command: Command, printed: bytes, used: int) -> bytes:
    """Return a package with its first slot for the drive, and the others for those next to it."""
    assert command.slots is not None  # only packages are asked for
    own, data = probe.address, bytearray(printed[1:-1])
    others = [a for a in range(own + 1, own + 5) if a <= probe.dialect.addresses[1]] + list(range(own - 4, own))
    for index, address in enumerate([own, *[a for a in others if a > 0]][:used]):
        data[index * command.slots.size] = address
    return probe.dialect.link.completed(printed[:1] + bytes(data))
