"""Homing: how a drive finds its end stop, or an obstacle, and what it then calls zero.

An end stop or an obstacle must be where the claim expects it, so homing is tried on emulated drives alone.

Rules kept here:
- `home_direction` 0 is clockwise, and clockwise lowers the counts.
- Where the drive tells the end (native, CAN) that is listened to; where it does not (Modbus), F1 is asked until it is no
  longer 5.
- Which dialects let the shaft go at the end stop while the end limit is on stands in a table: the CAN manual has no such
  note.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Claim, Inconclusive
from conformance.claims import world
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until

_CW, _CCW = 0, 1
_SWITCH = 3000
#: Four seconds at 60 rpm.
_COUNTS_FAR = 4 * COUNTS_PER_TURN
_JITTER = 3
_HOMING = 5
_LIMIT_NS = 20 * SECOND_NS
#: With the end limit on, the shaft is let go where homing meets the end stop (5.3.1, Note 2).
_LETS_GO: Mapping[str, bool] = {"mks-rs485": True, "mks-modbus": True, "mks-can": False}
_WAYS = {_CW: -1, _CCW: 1}
_NAMES = {_CW: "cw", _CCW: "ccw"}


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about homing."""
    home, setting = dialect.by_verb[Verb.HOME], dialect.by_verb[Verb.SET_HOME]
    risks = home.all_risks | setting.all_risks
    made = partial(motion_claim, dialect, home, emulated=True, risks=risks, settings=_fields(dialect))
    for direction, name in _NAMES.items():
        yield made(
            f"finds-switch-{name}",
            f"Homing with direction {name} turns the shaft {name} until the end stop closes, and it stands there.",
            "a shaft that goes the other way or stops elsewhere",
            partial(_finds_switch, direction),
        )
        yield made(
            f"from-closed-{name}",
            "From a closed end stop the shaft first turns the other way, then comes back to it.",
            "a shaft that does not leave the end stop, or stops elsewhere",
            partial(_from_closed, direction),
            risks=risks | _way_back_risks(dialect),
        )
    yield made("zero", "Where homing ends is zero, of the encoder and of the pulses.", "another number", _zero_at_home)
    for rpm in (60, 120, 300):
        yield made(
            f"speed-{rpm}", f"With home_speed {rpm} homing turns the shaft at {rpm} rpm.", "another speed",
            partial(_speed, rpm),
        )  # fmt: skip
    yield made("status", "While homing F1 reads 5, and afterwards 1.", "another status", _status)
    yield made(
        "trigger", "With home_trigger 1 the end stop counts as reached when its pin is high: when it opens.",
        "a shaft that stops at the low level, or runs on", _trigger,
    )  # fmt: skip
    yield made(
        "disabled", "Homing is refused while the motor is disabled.", "a motion, or an answer that says success",
        _refused_disabled, at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        "stopped", "An emergency stop ends homing, and it is not told as done.", "a shaft that goes on, or success",
        _stopped, at_best=Certainty.LIKELY,
    )  # fmt: skip
    lets_go = _LETS_GO[dialect.name]
    yield made(
        "end-limit", f"With the end limit on the shaft is {'let go' if lets_go else 'held'} at the end stop.",
        "a motor that is enabled" if lets_go else "a motor that is disabled", partial(_held_after, 1, not lets_go),
        at_best=Certainty.CERTAIN if lets_go else Certainty.LIKELY,
    )  # fmt: skip
    yield made(
        "holds", "With the end limit off the shaft is held at the end stop.", "a motor that is disabled",
        partial(_held_after, 0, True), at_best=Certainty.LIKELY,
    )  # fmt: skip
    if moves.tells(dialect):
        yield made("replies", "Homing is answered by 1 when it begins and by 2 when home is found.", "others", _replies)
    if _mode_setting(dialect) is not None:
        for direction, name in _NAMES.items():
            for angle in (0x1000, 0x3000):
                yield made(
                    f"without-switch-{name}-{angle:x}",
                    f"Without an end stop the shaft turns {name} until it is held, goes back by {angle:#x} counts, and "
                    "that point is zero.",
                    "another place",
                    partial(_without_switch, direction, angle),
                    risks=risks | _way_back_risks(dialect),
                )


def _way_back_risks(dialect: Dialect) -> frozenset[Risk]:
    """Return the risks of setting the way back, where a dialect has a command for it."""
    command = dialect.by_verb.get(Verb.SET_NO_LIMIT_HOME)
    return frozenset() if command is None else command.all_risks


def _fields(dialect: Dialect) -> tuple[str, ...]:
    commands = [dialect.by_verb.get(v) for v in (Verb.SET_HOME, Verb.SET_NO_LIMIT_HOME)]
    names = [n for c in commands if c is not None for f in c.request_forms for n in f.layout.named]
    return tuple(dict.fromkeys(names))


# --- homing -----------------------------------------------------------------------------------------------------------


def _mode_setting(dialect: Dialect) -> Command | None:
    """Return the command that sets the method of homing, None where a dialect has none."""
    for verb in (Verb.SET_NO_LIMIT_HOME, Verb.SET_HOME):
        command = dialect.by_verb.get(verb)
        if command is not None and any("home_mode" in f.layout.named for f in command.request_forms):
            return command
    return None


def set_home(probe: Probe, **values: int) -> None:
    """Set how the drive homes; what is not given: clockwise, at 60 rpm, a low pin, no end limit, by a switch."""
    wanted = {"home_trigger": 0, "home_direction": _CW, "home_speed": 60, "end_limit": 0, "home_mode": 0, **values}
    for verb in (Verb.SET_HOME, Verb.SET_NO_LIMIT_HOME):
        command = probe.dialect.by_verb.get(verb)
        if command is None:
            continue
        named = command.request_forms[0].layout.named
        given: dict[str, Any] = {n: v for n, v in wanted.items() if n in named}
        if verb is Verb.SET_HOME or "return_angle" in values:
            if "home_current" in named:
                given["home_current"] = 400
            probe.do(command, given)


def find_home(probe: Probe, limit_ns: int = _LIMIT_NS) -> Exchange:
    """Ask for homing and follow it to its end. Raises Inconclusive where it is refused."""
    home = probe.command(Verb.HOME)
    telling = moves.tells(probe.dialect)
    exchange = probe.ask(home, until=Until.DONE if telling else Until.REPLY, timeout_ns=limit_ns if telling else None)
    probe.reply(exchange)
    if probe.refused(exchange):
        raise Inconclusive("homing was refused")
    if not telling:
        moves.watch(probe, lambda: _status_now(probe) != _HOMING, every_ns=200 * MS, limit_ns=limit_ns)
    return exchange


def _status_now(probe: Probe) -> int:
    return probe.read(Verb.READ_STATUS, "status")


def _prepared(probe: Probe, **values: int) -> float:
    """Make a drive ready for homing; return where the shaft stands (counts of its own)."""
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    # Away from where it was made, so that its zero is not by chance where homing ends.
    moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.6)
    set_home(probe, **values)
    return world.shaft(probe)


def _expect_at(probe: Probe, exchange: Exchange, expected: float, what: str) -> None:
    at = world.shaft(probe)
    if abs(at - expected) > _JITTER:
        _halt(probe)
        raise refute(exchange, what, expected=f"{expected:.0f} counts", got=f"{at:.0f} counts")


def _halt(probe: Probe) -> None:
    probe.ask(Verb.EMERGENCY_STOP)


def _finds_switch(direction: int, probe: Probe, command: Command) -> None:
    start = _prepared(probe, home_direction=direction)
    way = _WAYS[direction]
    world.left_switch(probe, way * _SWITCH)
    exchange = find_home(probe)
    probe.wait(500 * MS)
    _expect_at(probe, exchange, start + way * _SWITCH, "homing does not end at the end stop")


def _from_closed(direction: int, probe: Probe, command: Command) -> None:
    start = _prepared(probe, home_direction=direction, return_angle=0x2000)
    way = _WAYS[direction]
    world.switch_here(probe, way, 1000)
    exchange = probe.ask(command, quiet_ns=0)
    probe.reply(exchange)
    probe.wait(50 * MS)
    first = (world.shaft(probe) - start) * way
    if moves.tells(probe.dialect):
        probe.listen(5 * SECOND_NS)
    else:
        probe.wait(5 * SECOND_NS)
    if first >= 0:
        _halt(probe)
        text = "homing from a closed end stop does not leave it first"
        raise refute(exchange, text, expected="motion away from it", got=f"{first:.0f} counts towards it")
    _expect_at(probe, exchange, start - way * 1000, "homing from a closed end stop does not end at it")


def _zero_at_home(probe: Probe, command: Command) -> None:
    _prepared(probe)
    world.left_switch(probe, -_SWITCH)
    exchange = find_home(probe)
    probe.wait(500 * MS)
    for verb, name in ((Verb.READ_POSITION, "position"), (Verb.READ_PULSES, "pulses")):
        seen = probe.read(verb, name)
        if abs(seen) > _JITTER:
            raise refute(exchange, f"the {name} is not zero where homing ended", expected="0", got=str(seen))


def _speed(rpm: int, probe: Probe, command: Command) -> None:
    _prepared(probe, home_speed=rpm)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    seen = motion.speed(probe)
    _halt(probe)
    if abs(abs(seen.value) - rpm) > 1 + rpm / 100:
        text = "homing does not turn at the speed that was set"
        raise refute(exchange, text, expected=f"{rpm} rpm", got=f"{abs(seen.value):g} rpm")


def _status(probe: Probe, command: Command) -> None:
    _prepared(probe)
    world.left_switch(probe, -_COUNTS_FAR)
    exchange = probe.do(command)
    probe.wait(300 * MS)
    during = _status_now(probe)
    probe.wait(6 * SECOND_NS)
    after = _status_now(probe)
    _halt(probe)
    if (during, after) != (_HOMING, 1):
        text = "the status does not tell of homing and of its end"
        raise refute(exchange, text, expected="5, then 1", got=f"{during}, then {after}")


def _trigger(probe: Probe, command: Command) -> None:
    _prepared(probe, home_trigger=1)
    world.press(probe)
    start = world.shaft(probe)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    went = world.shaft(probe) - start
    if went > -COUNTS_PER_TURN / 4:
        _halt(probe)
        text = "with home_trigger 1 a low pin stops homing, or turns it round"
        raise refute(exchange, text, expected="about -16000 counts in a second", got=f"{went:+.0f} counts")
    world.press(probe, False)
    probe.wait(300 * MS)
    at = world.shaft(probe)
    probe.wait(SECOND_NS)
    if abs(world.shaft(probe) - at) > _JITTER:
        _halt(probe)
        text = "with home_trigger 1 a high pin does not end homing"
        raise refute(exchange, text, expected="a shaft that stands", got="a shaft that turns")


def _refused_disabled(probe: Probe, command: Command) -> None:
    start = _prepared(probe)
    probe.do(Verb.ENABLE, {"enabled": 0})
    exchange = probe.ask(command)
    answer = probe.reply(exchange)
    probe.wait(SECOND_NS)
    went = world.shaft(probe) - start
    if abs(went) > _JITTER:
        _halt(probe)
        raise refute(exchange, "homing turns a disabled motor", expected="no motion", got=f"{went:+.0f} counts")
    if not probe.refused(exchange):
        text = "homing is not refused while the motor is disabled"
        raise refute(exchange, text, expected="a refusal", got=answer.data.hex(" ").upper())


def _stopped(probe: Probe, command: Command) -> None:
    _prepared(probe)
    since = len(probe.traffic)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    _halt(probe)
    at = world.shaft(probe)
    probe.wait(3 * SECOND_NS)
    went = world.shaft(probe) - at
    if abs(went) > _JITTER:
        text = "an emergency stop does not end homing"
        raise refute(exchange, text, expected="a shaft that stands", got=f"{went:+.0f} counts")
    if moves.tells(probe.dialect):
        told = [a.values["status"] for a in moves.told(probe.traffic[since:], command)]
        if 2 in told:
            text = "homing that was stopped is told as done"
            raise refute(exchange, text, expected="no status 2", got=", ".join(map(str, told)))


def _held_after(end_limit: int, held: bool, probe: Probe, command: Command) -> None:
    _prepared(probe, end_limit=end_limit)
    world.left_switch(probe, -_SWITCH)
    exchange = find_home(probe)
    probe.wait(500 * MS)
    if bool(probe.read(Verb.READ_ENABLED, "enabled")) is not held:
        names = ("let go", "held")
        text = f"with end_limit {end_limit} the shaft is {names[not held]} after homing"
        raise refute(exchange, text, expected=names[held], got=names[not held])


def _replies(probe: Probe, command: Command) -> None:
    _prepared(probe)
    world.left_switch(probe, -_COUNTS_FAR // 2)
    since = len(probe.traffic)
    exchange = find_home(probe)
    probe.wait(2 * SECOND_NS)
    told = [a.values["status"] for a in moves.told(probe.traffic[since:], command)]
    if told != [1, 2]:
        got = ", ".join(map(str, told)) or "none"
        raise refute(exchange, "homing is not answered by 1 and then 2", expected="1, 2", got=got)


def _without_switch(direction: int, angle: int, probe: Probe, command: Command) -> None:
    start = _prepared(probe, home_direction=direction, home_mode=1, return_angle=angle)
    way = _WAYS[direction]
    world.wall(probe, way * _SWITCH)
    exchange = find_home(probe)
    probe.wait(500 * MS)
    _expect_at(probe, exchange, start + way * (_SWITCH - angle), "homing without an end stop ends elsewhere")
    seen = probe.read(Verb.READ_POSITION, "position")
    if abs(seen) > _JITTER:
        raise refute(exchange, "the position is not zero where homing ended", expected="0", got=str(seen))
