"""A kept zero (9A): the shaft goes back to it when the drive restarts or power comes on, and not to one that was cleaned.

    set_zero_mode/restart                       the way that was set, and faster by a higher speed; what 3B says meanwhile
    set_zero_mode/clean, off                    a zero that was forgotten, and the mode that goes back to none
    set_zero_mode/near, direction-..., faster   from anywhere in the turn, at each speed: on emulated drives, whose power is cut
    read_zero_status/tells...                   what 3B says meanwhile: likewise

Rules kept here:
- The way back is less than a turn; where the shaft stood before does not matter to it but within the turn.
- 3B reads 0 on the way and 1 when it is over.
- A drive may take two seconds to start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations, pairwise
from typing import Any, NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.mks_shared import ZeroStatus
from conformance.claims import bench
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.claims.settings.read_back import of_read_back
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe
from conformance.talk.restarts import restart

#: Speeds that are one, as a share; counts within which a shaft is where it should be.
_SHARE, _PLAY = 0.1, 100
#: How long a drive takes to start, and the way back at the slowest.
_START_NS, _BACK_NS = 3 * SECOND_NS, 20 * SECOND_NS
#: The modes, and the directions.
_OFF, _BY_DIRECTION, _NEAR = 0, 1, 2
_CW, _CCW = 0, 1
#: Zero mode 0, and no zero.
_CLEANED = {"zero_mode": _OFF, "set_zero": 0, "zero_speed": 0, "zero_direction": _CW}


# --- when it restarts -------------------------------------------------------------------------------------------------


def _zero_modes(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.SET_ZERO_MODE)
    if command is not None:
        fields = tuple(command.request_forms[0].layout.named)
        risks = command.risks({"zero_mode": _NEAR}) | command.risks({"zero_mode": _OFF}) | declared.risks(dialect)
        facts = {
            "fields": fields,
            "risks": risks | dialect.by_verb[Verb.RESTART].all_risks,
            "settings": declared.settings(dialect, *fields),
        }
        yield Case(dialect, command, {}, facts)


class _Back(NamedTuple):
    """A way back to zero. `turns`: from the zero, counted clockwise where the direction decides, else as the encoder does."""

    mode: int
    direction: int
    speed: int
    turns: float


class _Came(NamedTuple):
    """What came of one. `wanted`: the way that it should take; `on_way`: the speed that the shaft had, where it was seen.

    `meanwhile`: what 3B said of a shaft that was seen to turn; `status`, `off`: what it said at the end, and by how many counts
    the shaft missed its zero.
    """

    back: _Back
    exchange: Exchange
    wanted: int
    on_way: float | None
    meanwhile: int | None
    status: int
    off: int


#: By the shorter way though the direction says the other one; by the direction the longer way.
#: Each direction has the fastest way back, for which no other speed could be taken, and one of them the slowest too; what is
#: slow has a short way.
_BACKS = (
    _Back(_NEAR, _CCW, 0, 0.18),
    _Back(_BY_DIRECTION, _CW, 4, 0.3),
    _Back(_BY_DIRECTION, _CCW, 4, -0.3),
    _Back(_BY_DIRECTION, _CCW, 0, 0.35),
)
#: How the shaft leaves its zero: a third of a turn takes less time than the drive to start.
_LEAVES_RPM, _LEAVES_RAMP = 300, 252
#: Between two looks at a shaft on its way back, and the speed of one that surely turns; how long it has to set off.
_ON_WAY_NS, _TURNS_RPM, _UNDER_WAY_NS = 25 * MS, 10, 150 * MS


@of_read_back(
    each=_zero_modes,
    name="{command}/restart",
    refuted_by="another place, another way, or another speed",
    at_best=Certainty.LIKELY,
)
def _returns_to_zero(probe: Probe, command: Command) -> None:
    """With a zero kept, the shaft goes back to it after a restart: the way that was set, and faster by a higher speed."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    clockwise = arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), -18)
    sense = 1 if clockwise.degrees > 0 else -1
    try:
        every = [_come_back(probe, command, back, sense) for back in _BACKS]
    finally:
        probe.do(command, _CLEANED)
    for came in every:
        shown = f"zero_mode {came.back.mode}, zero_direction {came.back.direction}, {came.back.turns:+g} turns from the zero"
        # The drive takes the end of the way back for its zero, so that the angle within the turn is what shows it.
        probe.expect(
            f"{came.off} counts off, 3B {came.status}",
            holds=came.status == 1 and came.off <= _PLAY,
            expected=f"zero, and 3B 1: {shown}",
            refutes=f"the shaft is {came.off} counts off after a restart, and 3B says {came.status}",
            exchange=came.exchange,
            key="zero mode",
        )
        if came.meanwhile is not None:
            text = f"3B says {came.meanwhile} while the shaft goes back to its zero"
            probe.expect(came.meanwhile, equal=ZeroStatus.GOING, refutes=text, exchange=came.exchange, key="3B meanwhile")
        if came.on_way is not None:
            text = "the shaft goes the other way back to its zero"
            right = came.on_way * came.wanted > 0
            told = f"{came.on_way:+.3g} rpm"
            probe.expect(told, holds=right, expected=f"the other way: {shown}", refutes=text, exchange=came.exchange)
    speeds = sorted((came.back.speed, abs(came.on_way)) for came in every if came.on_way is not None)
    for (slow, rpm), (fast, more) in combinations(speeds, 2):
        if slow < fast:
            text = "a higher zero_speed does not bring the shaft back faster"
            expected = f"more than at {slow}: {rpm:.3g} rpm"
            probe.expect(f"{more:.3g} rpm at {fast}", holds=more > rpm, expected=expected, refutes=text)


def _come_back(probe: Probe, command: Command, back: _Back, sense: int) -> _Came:
    """Keep a zero, go away from it and restart. `sense`: 1 where clockwise raises the position."""
    turn = probe.dialect.counts_per_turn
    motion.ready_to_move(probe)
    by_direction = back.mode == _BY_DIRECTION
    values = {"zero_mode": back.mode, "set_zero": 1, "zero_speed": back.speed, "zero_direction": back.direction}
    probe.do(command, values)
    away = back.turns * (sense if by_direction else 1)
    _go_away(probe, away)
    exchange = restart(probe, arrives=False)
    rpm, meanwhile = _on_its_way(probe)
    motion.wait_standing(probe)
    status, now = probe.read(Verb.READ_ZERO_STATUS), probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    wanted = sense * (1 if back.direction == _CW else -1) if by_direction else (-1 if away > 0 else 1)
    return _Came(back, exchange, wanted, rpm, meanwhile, status, min(now, turn - now))


def _go_away(probe: Probe, turns: float) -> None:
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), turns * 360, rpm=_LEAVES_RPM, acceleration=_LEAVES_RAMP)


def _on_its_way(probe: Probe) -> tuple[float | None, int | None]:
    """Return the speed of a shaft that turns and what 3B says of it, if that can be read.

    Neither is told of one that does not turn, or whose place jumps to zero at the end.
    """
    looks = [motion.position(probe)]
    probe.wait(_ON_WAY_NS)
    looks.append(motion.position(probe))
    # Before most of the time in which the shaft still turns, so that it is asked once.
    told = probe.ask(Verb.READ_ZERO_STATUS, quiet_ns=0, timeout_ns=_ON_WAY_NS).reply
    probe.wait(_ON_WAY_NS)
    looks.append(motion.position(probe))
    (first, off), (second, off_too) = (motion.speed_between(one, other) for one, other in pairwise(looks))
    steady = abs(first - second) <= _SHARE * 3 * abs(first) + off + off_too and abs(first) > _TURNS_RPM
    if not steady:
        return None, None
    return (first + second) / 2, told.values.get("status") if told is not None else None


def _no_zeros(dialect: Dialect) -> Iterator[Case]:
    """Yield what a drive is told before and after it leaves its zero, so that it does not go back to it."""
    cleaned = {"zero_mode": _NEAR, "set_zero": 0, "zero_speed": 2, "zero_direction": _CW}
    kept = {**cleaned, "set_zero": 1}
    for name, how, before, after in (
        ("clean", "its zero cleaned", kept, cleaned),
        ("off", "zero mode 0", {**kept, "zero_mode": _OFF}, None),
    ):
        for case in _zero_modes(dialect):
            facts = {**case.facts, "parameters": {}}
            yield Case(dialect, case.command, {"name": name, "how": how, "before": before, "after": after}, facts)


@of_read_back(each=_no_zeros, name="{command}/{name}", refuted_by="a shaft that goes back", at_best=Certainty.LIKELY)
def _returns_to_none(probe: Probe, command: Command, how: str, before: dict[str, int], after: dict[str, int] | None) -> None:
    """With {how} the shaft stays where it is after a restart."""
    turn = probe.dialect.counts_per_turn
    # A zero that was set by a command or kept before is forgotten: the angle counts from where that of after does.
    probe.do(command, _CLEANED)
    restart(probe)
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    probe.do(command, before)
    _go_away(probe, 0.25)
    if after is not None:
        probe.do(command, after)
    was = probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    exchange = restart(probe, arrives=False)
    # One that goes back is under way by then.
    probe.wait(_UNDER_WAY_NS)
    motion.wait_standing(probe)
    now = probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    probe.do(command, _CLEANED)
    text = f"the shaft goes back after a restart with {how}"
    probe.expect((now - was) % turn, holds=_apart(now, was, turn) <= _PLAY, expected="0", refutes=text, exchange=exchange)


def _apart(one: int, other: int, turn: int) -> int:
    return min((one - other) % turn, (other - one) % turn)


# --- when power comes on ----------------------------------------------------------------------------------------------


def _of_zero(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"risks": {Risk.POWER_ON}, "settings": tuple(_CLEANED), **facts}
    return of_motion(each=each, refuted_by=refuted_by, emulated=True, **facts)


_by_power = commands(Verb.SET_ZERO_MODE)


#: How often it is looked whether the shaft is at its zero: two times that differ by less are one.
_SEEN_MS = 5


def _keep_zero(probe: Probe, mode: int, direction: int, turns: float, speed: int = 4) -> float:
    """Keep where the shaft is as zero, go away from it and cut the power; return where the zero is (counts of its own)."""
    motion.ready_to_move(probe)
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    arriving.follow(probe, move, 36)
    zero = bench.shaft(probe)
    values = {"zero_mode": mode, "set_zero": 1, "zero_speed": speed, "zero_direction": direction}
    probe.do(Verb.SET_ZERO_MODE, values)
    arriving.follow(probe, move, turns * 360)
    bench.power_cycle(probe)
    return zero


#: How far from its zero the shaft is left, in turns: near it, on either side of a quarter, of a half and of a whole turn.
#: A move of 0.2 turns has bytes that may begin a package, behind which nothing is let through.
_AWAY = (0.05, 0.22, 0.3, 0.45, 0.55, 0.7, 0.95, -0.2, -0.7, 1.3)


def _ways_back(dialect: Dialect) -> Iterator[Case]:
    for case in _by_power(dialect):
        facts = {"name": "set_zero_mode/near", "parameters": {}}
        yield Case(dialect, case.command, {"mode": _NEAR, "direction": _CW}, facts)
        for name, direction in (("cw", _CW), ("ccw", _CCW)):
            facts = {
                "name": f"set_zero_mode/direction-{name}",
                "statement": f"In direction mode {name} the shaft goes back to its zero {name}, from anywhere in the turn.",
                "refuted_by": "another place, or the other way",
                "parameters": {},
            }
            yield Case(dialect, case.command, {"mode": _BY_DIRECTION, "direction": direction}, facts)


@_of_zero("another place, or the longer way", each=_ways_back)
def _goes_back(probe: Probe, mode: int, direction: int) -> None:
    """In near mode the shaft goes back to its zero the shorter way when power comes on, from anywhere in the turn."""
    for turns in _AWAY:
        zero = _keep_zero(probe, mode, direction, turns)
        probe.wait(_START_NS + _BACK_NS)
        # The zero is in each turn: the nearest one, or the next one that way.
        whole_turns = round(turns) if mode == _NEAR else math.ceil(turns) if direction == _CCW else math.floor(turns)
        text = "the shaft does not go back to its zero as it was set"
        near = zero + whole_turns * probe.dialect.counts_per_turn
        expected = f"{near:.0f} counts, from {turns:+g} turns"
        probe.expect(bench.shaft(probe), near=near, unit="counts", refutes=text, expected=expected)


@_of_zero("one that takes as long, or longer", each=_by_power)
def _faster(probe: Probe) -> None:
    """A higher zero_speed brings the shaft back faster."""
    took = []
    for speed in range(5):
        zero = _keep_zero(probe, _NEAR, _CW, 0.4, speed)
        begun_ns = probe.gate.now_ns()
        motion.wait_until(probe, partial(_is_at, probe, zero), every_ns=_SEEN_MS * MS, limit_ns=_START_NS + _BACK_NS)
        took.append((probe.gate.now_ns() - begun_ns) / 1e6)
    probe.expect(
        ", ".join(f"{t:.0f} ms" for t in took),
        holds=all(one - other > _SEEN_MS for one, other in pairwise(took)),
        expected="less time for each of 0 to 4",
        refutes="a higher zero_speed does not bring the shaft back faster",
    )


def _is_at(probe: Probe, place: float) -> bool:
    return abs(bench.shaft(probe) - place) <= probe.within("counts")


def _zero_statuses(dialect: Dialect) -> Iterator[Case]:
    if Verb.SET_ZERO_MODE in dialect.by_verb:
        for mode, direction, name in ((_NEAR, _CW, ""), (_BY_DIRECTION, _CW, "-cw"), (_BY_DIRECTION, _CCW, "-ccw")):
            given = {"mode": mode, "direction": direction}
            facts = {"name": f"{{command}}/tells{name}", "parameters": {}}
            yield Case(dialect, dialect.by_verb[Verb.READ_ZERO_STATUS], given, facts)


@_of_zero("other numbers", each=_zero_statuses, risks=risks_by(Verb.SET_ZERO_MODE))
def _tells(probe: Probe, command: Command, mode: int, direction: int) -> None:
    """3B reads 0 on the way back to zero and 1 when it is over."""
    _keep_zero(probe, mode, direction, 0.49, 0)
    # The first answer since the start: at the slowest the way back takes a second. What is asked before is lost.
    soon = partial(probe.ask, command, timeout_ns=100 * MS, quiet_ns=0)
    motion.wait_until(probe, lambda: not soon().silent, every_ns=50 * MS, limit_ns=5 * SECOND_NS)
    during = probe.reply(probe.traffic[-1]).values["status"]
    probe.wait(_BACK_NS)
    seen = (during, probe.read(command, "status"))
    probe.expect(seen, equal=(0, 1), refutes="3B does not tell of the way back")
