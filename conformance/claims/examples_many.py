"""Worked examples to several drives: to all of them, to a group, and packages. Executed, never answered.

FA 00 FD 01 2C 64 00 00 0C 80 14     "motor 1-6 will rotate a turn"
FA 50 FD 01 2C 64 00 00 0C 80 64     "motor 1-3 will rotate a turn", whose group address is 50h
FC 01 F6 00 32 0A ..                 "motor 1 rotates forward continuously"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from analyzer import encoder
from analyzer.catalogue import Command, Dialect, Role, Vector, Verb
from analyzer.decoder import slots_of
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.hearing import came
from conformance.motion import motion
from conformance.talk.exchange import Exchange, hex_of

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_SECOND_NS = 1_000_000_000
#: How long the examples may take: a turn at 300 rpm and less.
_MOVE_NS = 4 * _SECOND_NS
#: Degrees after which a move counts as one.
_MOVED = 90.0


def is_to_many(dialect: Dialect, command: Command, vector: Vector) -> bool:
    """Say whether a printed request is to all drives, or to a group."""
    return _group(dialect, command, vector) or _address(dialect, vector) == dialect.broadcast


def _address(dialect: Dialect, vector: Vector) -> int:
    data = bytes.fromhex(vector.corrected or vector.printed)
    if dialect.link.kind == "can":
        return data[0]
    return dialect.link.parse(data).address


def _group(dialect: Dialect, command: Command, vector: Vector) -> bool:
    setting = dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
    address = _address(dialect, vector)
    return setting is not None and vector.section == setting.section and address not in (1, dialect.broadcast)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about printed requests to several drives, and about printed packages."""
    for command in dialect.commands:
        many = [v for v in command.vectors if v.role is Role.REQUEST]
        if command.slots is not None:
            # What is printed with an erratum is the same package as corrected.
            frames: dict[str, Vector] = {}
            for vector in many:
                frames.setdefault(vector.corrected or vector.printed, vector)
            for number, (printed, vector) in enumerate(frames.items(), 1):
                yield _package(dialect, command, bytes.fromhex(printed), vector, number)
            continue
        for number, vector in enumerate((v for v in many if is_to_many(dialect, command, v)), 1):
            yield _many(dialect, command, vector, number)


def _many(dialect: Dialect, command: Command, vector: Vector, number: int) -> Claim:
    to = _address(dialect, vector)
    in_group = _group(dialect, command, vector)
    setting = dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
    risks = set(encoder.assemble(dialect, command, 1, vector.values).risks) | motion.risks(dialect)
    changed: tuple[str, ...] = ()
    if in_group and setting is not None:
        risks |= setting.all_risks
        changed = ("group_address",)

    def check(probe: Probe) -> None:
        motion.ready_to_move(probe)
        if in_group:
            probe.do(Verb.SET_GROUP_ADDRESS, {"group_address": to})
        before = motion.position(probe).value
        sent = probe.send(probe.build(command, vector.values, address=to).item(), timeout_ns=_MOVE_NS)
        moved = motion.position(probe).value - before
        _judge(sent, moved, lambda: _moves_alone(probe, command, vector))

    return declare(
        dialect,
        Theme.EXAMPLES,
        f"{command.name}/to_{'group' if in_group else 'all'}_{number}",
        f"The printed request {vector.printed} turns the motor and is not answered.",
        "an answer, or no move",
        check,
        command=command,
        section=vector.section,
        aspect=Aspect.EXAMPLE,
        alone=True,
        risks=risks,
        settings=motion.settings(dialect, *changed),
        parameters={"printed": vector.printed},
    )


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
    probe.wait(_SECOND_NS)
    moved = motion.position(probe).value - before
    motion.stop(probe)
    probe.wait(_SECOND_NS)
    return abs(moved) >= _MOVED


def _judge(sent: Exchange, moved: float, moves_alone: Callable[[], bool]) -> None:
    what = hex_of(sent.sent or b"")
    if not sent.silent:
        raise Refuted("the example is answered", expected=f"silence after {what}", got=came(sent), exchange=sent)
    if abs(moved) < _MOVED:
        if not moves_alone():
            raise Inconclusive("no move can be seen when the drive is told by itself either")
        text = "the example does not turn the motor"
        raise Refuted(text, expected=f"a move after {what}", got=f"{moved:.1f} degrees", exchange=sent)


def _package(dialect: Dialect, command: Command, printed: bytes, vector: Vector, number: int) -> Claim:
    assert command.slots is not None  # asked by `claims`
    size = command.slots.size
    slots = slots_of(dialect, command, printed[1:-1])
    risks = set(motion.risks(dialect))
    for slot in slots:
        if slot.command is not None:
            risks |= slot.command.all_risks

    def addressed(own: int) -> bytes:
        """Return the package with its first slot for the drive, and the others for those next to it."""
        data = bytearray(printed[1:-1])
        others = [a for a in range(own + 1, own + 5) if a <= dialect.addresses[1]] + list(range(own - 4, own))
        for index, address in enumerate([own, *[a for a in others if a > 0]][: len(slots)]):
            data[index * size] = address
        return dialect.link.completed(printed[:1] + bytes(data))

    def check(probe: Probe) -> None:
        motion.ready_to_move(probe)
        before = motion.position(probe).value
        sent = probe.send(addressed(probe.address), timeout_ns=_MOVE_NS)
        moved = motion.position(probe).value - before
        motion.stop(probe)
        probe.wait(_SECOND_NS)
        _judge(sent, moved, lambda: _runs_alone(probe))

    return declare(
        dialect,
        Theme.EXAMPLES,
        f"{command.name}/{number}",
        "The printed package makes its first drive run at a speed, and is not answered.",
        "an answer, or no run",
        check,
        command=command,
        section=vector.section,
        aspect=Aspect.EXAMPLE,
        errata=(vector.erratum,) if vector.erratum else (),
        alone=True,
        risks=risks,
        settings=motion.settings(dialect),
        parameters={"printed": vector.printed},
    )
