"""Homing crossed with what is under way, and with what it is set to: its way, its speed, and what takes it over or ends it.

    motion under way x way                                    homing takes over from it
    mode x direction x switch x subdivision                   any two: homing has its way and its speed
    emergency stop, disabling x direction x switch            homing ends
    the motor's direction                                     homing keeps its own

Rules kept here:
- No switch is reached: the shaft is looked at while it searches, and stopped.
- Which way clockwise is, is the drive's own word: that of the first row.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Trait, Verb
from conformance.claim import Inconclusive
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion import homing
from conformance.claims.motion.motion_claim import of_motion
from conformance.model import covering
from conformance.motion import arriving, declared, motion
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, QUICK, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe

#: How far the older motion goes (degrees), when homing comes, and when that has its speed.
_FAR, _GOING_NS, _RUNS_NS = 720, 80 * MS, 110 * MS
#: At what speed homing turns, which is that of no older motion; one of two bytes; how long a shaft is looked at that homes.
_HOME_RPM, _FAST_RPM, _HOMES_NS = 120, 300, 60 * MS
#: By how much a speed of homing is above that of its mode (rpm).
_ABOVE_MODE = 200


def _homes(dialect: Dialect) -> Iterator[Case]:
    if Verb.HOME in dialect.by_verb and Verb.SET_HOME in dialect.by_verb and motions_of(dialect):
        home, sets = dialect.by_verb[Verb.HOME], [dialect.by_verb.get(v) for v in (Verb.SET_HOME, Verb.SET_NO_LIMIT_HOME)]
        known = [command for command in sets if command is not None]
        risks = frozenset[Risk]().union(*(c.all_risks for c in (home, *known, *motions_of(dialect)))) - {Risk.UNKNOWN}
        names = dict.fromkeys(name for c in known for name in c.request_forms[0].layout.named)
        facts = {
            "risks": declared.risks(dialect, *risks, Risk.UNBOUNDED, Risk.TORQUE),
            "settings": declared.settings(dialect, *names),
        }
        yield Case(dialect, home, facts=facts | {"parameters": {}})


def _seen(probe: Probe, begun: Exchange) -> tuple[float, float, int]:
    """Return the speed of homing (rpm), its uncertainty, and the status meanwhile, once it has its speed; end it."""
    probe.wait(begun.sent_ns + _RUNS_NS - probe.gate.now_ns())
    first = motion.position(probe)
    status = probe.read(Verb.READ_STATUS, "status") if Verb.READ_STATUS in probe.dialect.by_verb else homing.HOMING
    probe.wait(int(first.t_ns) + _HOMES_NS - probe.gate.now_ns())
    rpm, spread = motion.speed_between(first, motion.position(probe))
    probe.ask(Verb.EMERGENCY_STOP)
    motion.wait_standing(probe)
    return rpm, spread, status


def _homed(probe: Probe, command: Command) -> tuple[Exchange, tuple[float, float, int]]:
    """Ask for homing; return what was said and what is seen of it."""
    exchange = probe.ask(command, quiet_ns=0)
    return exchange, _seen(probe, exchange)


def _over(probe: Probe, older: Command, way: int, command: Command) -> tuple[Exchange, tuple[float, float, int]]:
    """Ask for homing while another motion turns the shaft."""
    asked = way * CALM if declared.of(older).kind is MotionKind.RUN else CALM
    motion.ask(probe, older, way * _FAR, rpm=asked, acceleration=QUICK, quiet_ns=0)
    probe.wait(_GOING_NS)
    return _homed(probe, command)


@of_motion(
    each=_homes,
    name="{command}/takes-over",
    refuted_by="a shaft that goes on as before, or a refusal",
    at_best=Certainty.LIKELY,
)
def _home_takes_over(probe: Probe, command: Command) -> None:
    """Homing takes over from each motion, either way: the shaft turns at the speed of homing, and F1 says so."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    homing.set_home(probe, home_speed=_HOME_RPM)
    every = motions_of(probe.dialect)
    both = [(run, way) for run in every for way in (1, -1) if declared.of(run).kind is MotionKind.RUN]
    for older, way in (
        *both,
        *((move, (-1) ** n) for n, move in enumerate(every) if declared.of(move).kind is not MotionKind.RUN),
    ):
        exchange, (rpm, spread, status) = undamaged(probe, _over, older, way, command)
        text, shown = f"{command.name} does not take over from another motion", f"over {older.name}, {'+' if way > 0 else '-'}"
        told: dict[str, Any] = {"refutes": text, "exchange": exchange}
        refused = not exchange.is_read or probe.refused(exchange)
        probe.expect("a refusal or no answer", holds=not refused, expected=f"homing, {shown}", **told)
        within = _HOME_RPM * 2 * CLOCK_SHARE + spread + 2
        probe.expect(abs(rpm), near=_HOME_RPM, within=within, unit="rpm", expected=f"{_HOME_RPM} rpm, {shown}", **told)
        probe.expect(f"status {status}", holds=status == homing.HOMING, expected=f"status {homing.HOMING}, {shown}", **told)


def _turning_homes(dialect: Dialect) -> Iterator[Case]:
    return (Case(case.dialect, case.command, {}, case.facts) for case in _homes(dialect))


@of_motion(each=_turning_homes, name="{command}/turns", refuted_by="another way or another speed", at_best=Certainty.LIKELY)
def _home_turns(probe: Probe, command: Command) -> None:
    """Homing turns the shaft at its speed and by its direction in each mode, with and without a switch, at each subdivision."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    law = probe.dialect.subdivision
    assert law is not None  # it homes by a speed as sent
    sense = 0.0
    factors = {
        "mode": tuple(reversed(declared.bus_modes(probe.dialect))),
        "direction": (0, 1),
        "home_mode": homing.modes(probe.dialect),
        "subdivision": (SUBDIVISION, 8),
        "home_speed": (_HOME_RPM, _FAST_RPM),
    }
    for row in covering.rows(factors, lambda home_speed, subdivision: home_speed == _HOME_RPM or subdivision in law.plain):
        motion.ready_to_move(probe, row["mode"], subdivision=row["subdivision"])
        homing.set_home(
            probe, home_speed=row["home_speed"], home_direction=row["direction"], home_mode=row["home_mode"], return_angle=0
        )
        begun, (rpm, spread, status) = undamaged(probe, _homed, command)
        shown = ", ".join(f"{name} {value}" for name, value in row.items())
        text = "homing turns another way or at another speed in one condition"
        real = row["home_speed"] * (1 if row["subdivision"] in law.plain else law.counted_at / row["subdivision"])
        # Which way clockwise is, is the drive's own word: that of the first row.
        way = 1 if row["direction"] == 0 else -1
        sense = sense or math.copysign(1, rpm * way)
        wanted = real * sense * way
        probe.expect(
            rpm,
            near=wanted,
            within=real * 2 * CLOCK_SHARE + spread + 2,
            unit="rpm",
            expected=f"{wanted:+g} rpm: {shown}",
            refutes=text,
            exchange=begun,
        )
        text, wanted_status = "the status does not tell of homing in one condition", f"status {homing.HOMING}: {shown}"
        told = f"status {status}"
        probe.expect(told, holds=status == homing.HOMING, expected=wanted_status, refutes=text, exchange=begun)
    homing.set_home(probe)


def _directions_of_homing(dialect: Dialect) -> Iterator[Case]:
    """Yield the setting of the motor's direction; whether it turns homing too where it turns motion, is not said."""
    turns, command = Trait.DIRECTION_TURNS_BUS_MOTION in dialect.traits, dialect.by_verb.get(Verb.SET_DIRECTION)
    for case in _homes(dialect) if command is not None else ():
        facts = {
            "settings": (*case.facts["settings"], "motor_direction"),
            "at_best": Certainty.OPEN if turns else Certainty.LIKELY,
        }
        yield Case(dialect, command, {"home": case.command}, {**case.facts, **facts})


@of_motion(each=_directions_of_homing, name="{command}/and-{home}", refuted_by="homing that turns the other way")
def _direction_and_homing(probe: Probe, command: Command, home: Command) -> None:
    """Homing turns by its own direction; that of the motor does not change it."""
    motion.ready_to_move(probe, subdivision=declared.SUBDIVISION)
    homing.set_home(probe, home_speed=_HOME_RPM)
    found = []
    for value in (0, 1):
        exchange = probe.do(command, {"motor_direction": value})
        _, (rpm, _, _) = undamaged(probe, _homed, home)
        found.append(rpm)
    text, shown = "the setting of the motor's direction turns homing", f"{found[0]:+.0f} and {found[1]:+.0f} rpm"
    probe.expect(shown, holds=found[0] * found[1] > 0, expected="one way", refutes=text, exchange=exchange, key=text)


def _homes_in_modes(dialect: Dialect) -> Iterator[Case]:
    return _turning_homes(dialect) if dialect.mode_speeds else iter(())


@of_motion(each=_homes_in_modes, name="{command}/within-mode", refuted_by="a shaft that is faster", at_best=Certainty.LIKELY)
def _home_within_mode(probe: Probe, command: Command) -> None:
    """Homing turns no faster than the slowest work mode allows, where a higher speed is set."""
    limits = probe.dialect.mode_speeds
    mode = min(declared.bus_modes(probe.dialect), key=limits.__getitem__)
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)
    homing.set_home(probe, home_speed=limits[mode] + _ABOVE_MODE, home_mode=1, return_angle=0)
    begun = probe.ask(command, quiet_ns=0)
    rpm, spread, _ = _seen(probe, begun)
    homing.set_home(probe)
    most = limits[mode] * (1 + 2 * CLOCK_SHARE) + spread + 2
    text = f"homing is faster than {mode} allows"
    probe.expect(abs(rpm), at_most=most, unit="rpm", refutes=text, exchange=begun)


def _ends_of_homing(dialect: Dialect) -> Iterator[Case]:
    """Yield what ends homing: the emergency stop, and disabling the motor."""
    for case in _homes(dialect):
        assert case.command is not None
        for verb, values in ((Verb.EMERGENCY_STOP, {}), (Verb.ENABLE, {"enabled": 0})):
            command = dialect.by_verb.get(verb)
            if command is not None:
                facts = {**case.facts, "risks": case.facts["risks"] | command.all_risks}
                yield Case(dialect, command, {"home": case.command, "values": values}, facts)


@of_motion(each=_ends_of_homing, name="{command}/ends-{home}", refuted_by="a shaft that goes on", at_best=Certainty.LIKELY)
def _ends_homing(probe: Probe, command: Command, home: Command, values: dict[str, int]) -> None:
    """{command} ends homing in both directions, with and without a switch: the shaft stands, and no success is told."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    for row in covering.rows({"home_direction": (0, 1), "home_mode": homing.modes(probe.dialect)}):
        homing.set_home(probe, home_speed=_HOME_RPM, return_angle=0, **row)
        first, since = motion.position(probe), len(probe.traffic)
        begun = probe.ask(home, quiet_ns=0)
        probe.wait(begun.sent_ns + _RUNS_NS - probe.gate.now_ns())
        turning = abs(motion.position(probe).value - first.value) > 1 + first.noise
        exchange = probe.ask(command, values, quiet_ns=0)
        probe.wait(_HOMES_NS)
        at = motion.position(probe)
        probe.wait(_HOMES_NS)
        went = motion.position(probe).value - at.value
        motion.stop(probe, 0)
        motion.switch(probe, True)
        if not turning:
            raise Inconclusive("homing does not turn the shaft")
        most = motion.same(probe) + probe.noise.swing
        text = f"{command.name} does not end homing with {', '.join(f'{name} {value}' for name, value in row.items())}"
        probe.expect(abs(went), at_most=most, unit="degrees", refutes=text, exchange=exchange)
        told = arriving.statuses(probe.traffic[since:], home) if arriving.tells_end(probe.dialect) else []
        text = f"homing that {command.name} ended is told as success"
        probe.expect(told, holds=homing.HOMED not in told, expected="no 2", refutes=text, exchange=exchange)
