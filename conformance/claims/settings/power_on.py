"""Power-on: the way back to a kept zero (9A), a kept run (FF), whether the shaft is held (CAN), and the restart (41).

Power is cut of emulated drives alone; a kept run would turn a real motor as soon as power comes on.

Rules kept here:
- The way back is less than a turn; where the shaft stood before does not matter to it but within the turn.
- 3B reads 0 on the way and 1 when it is over.
- A drive may take two seconds to start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.motion import arriving, motion
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.probe import Probe
from conformance.talk.restarts import need_axis_lock, wait_for_answer

_START_NS = 3 * SECOND_NS
#: How long a shaft is looked at behind a restart that may take a motion up again: a run has its speed by then.
_RESUMES_NS = SECOND_NS
#: How long the way back takes at the slowest: less than a turn.
_BACK_NS = 20 * SECOND_NS
_OFF, _BY_DIRECTION, _NEAR = 0, 1, 2
_CW, _CCW = 0, 1
_ZERO_SETTINGS = ("zero_mode", "set_zero", "zero_speed", "zero_direction")


# --- the way back to zero ---------------------------------------------------------------------------------------------


def _of_zero(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"risks": {Risk.POWER_ON}, **facts}
    return of_motion(each=each, refuted_by=refuted_by, emulated=True, settings=_ZERO_SETTINGS, **facts)


_zero_modes = commands(Verb.SET_ZERO_MODE)


#: How often it is looked whether the shaft is at its zero: two times that differ by less are one.
_SEEN_MS = 5


def _keep_zero(probe: Probe, mode: int, direction: int, turns: float, speed: int = 4, keep: int = 1) -> float:
    """Keep where the shaft is as zero, go away from it and cut the power; return where the zero is (counts of its own)."""
    motion.ready_to_move(probe)
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    arriving.follow(probe, move, 36)
    zero = bench.shaft(probe)
    values = {"zero_mode": mode, "set_zero": keep, "zero_speed": speed, "zero_direction": direction}
    probe.do(Verb.SET_ZERO_MODE, values)
    arriving.follow(probe, move, turns * 360)
    bench.power_cycle(probe)
    return zero


#: How far from its zero the shaft is left, in turns: near it, on either side of a quarter, of a half and of a whole turn.
#: A move of 0.2 turns has bytes that may begin a package, behind which nothing is let through.
_AWAY = (0.05, 0.22, 0.3, 0.45, 0.55, 0.7, 0.95, -0.2, -0.7, 1.3)


def _ways_back(dialect: Dialect) -> Iterator[Case]:
    for case in _zero_modes(dialect):
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


def _no_zeros(dialect: Dialect) -> Iterator[Case]:
    for case in _zero_modes(dialect):
        assert case.command is not None
        facts = {
            "name": "set_zero_mode/off",
            "statement": "With zero mode 0 nothing turns when power comes on.",
            "at_best": Certainty.CERTAIN,
            "risks": motion.risks(dialect, *case.command.risks({"zero_mode": _OFF})),
        }
        yield Case(dialect, case.command, {"mode": _OFF, "keep": 1}, facts)
        yield Case(dialect, case.command, {"mode": _NEAR, "keep": 0})


@_of_zero("a shaft that turns", each=_no_zeros, at_best=Certainty.LIKELY)
def _clean(probe: Probe, mode: int, keep: int) -> None:
    """Without a zero that was kept (set_zero 0) nothing turns when power comes on."""
    _keep_zero(probe, mode, _CW, 0.3, keep=keep)
    before = bench.shaft(probe)
    probe.wait(_START_NS + _BACK_NS)
    text = "the shaft goes back although there is no zero to go to"
    probe.expect(bench.shaft(probe) - before, near=0, unit="counts", refutes=text)


@_of_zero("one that takes as long, or longer", each=_zero_modes)
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


# --- a kept run -------------------------------------------------------------------------------------------------------


def _of_kept_run(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return of_motion(each=each, refuted_by=refuted_by, emulated=True, risks=risks_by(Verb.RUN_SPEED), **facts)


_saves = commands(Verb.SAVE_SPEED)


def _save(probe: Probe, state: str) -> None:
    command = probe.command(Verb.SAVE_SPEED)
    probe.do(command, {"save_state": motion.choice(command, "save_state", state)})


def _run_and_save(probe: Probe, direction: int) -> float:
    """Run and save the run; return the speed that the shaft had."""
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    motion.run_at(probe, -90 if direction else 90, QUICK)
    probe.wait(500 * MS)
    speed = motion.speed(probe).value
    if abs(speed) < 10:
        raise Inconclusive("the shaft does not turn before its run is saved")
    _save(probe, "save")
    return speed


def _speed_after_power(probe: Probe) -> float:
    bench.power_cycle(probe)
    probe.wait(_START_NS)
    return motion.speed(probe).value


def _expect_no_run(probe: Probe, refutes: str) -> None:
    after = _speed_after_power(probe)
    probe.expect(after, holds=abs(after) < 1 + probe.noise.rpm, expected="0 rpm", unit="rpm", refutes=refutes)


def _directions(dialect: Dialect) -> Iterator[Case]:
    for case in _saves(dialect):
        for direction in (0, 1):
            yield Case(dialect, case.command, {"direction": direction, "turned": "", "with_it": ""})
            if Verb.SET_DIRECTION in dialect.by_verb:
                facts = {"settings": motion.settings(dialect, "motor_direction"), "parameters": {}}
                given = {"direction": direction, "turned": "-turned", "with_it": " with the motor's direction turned"}
                yield Case(dialect, case.command, given, facts)


@_of_kept_run("no run, another speed, or the other way", each=_directions, name="{command}/runs-direction-{direction}{turned}")
def _goes_on(probe: Probe, direction: int, turned: str) -> None:
    """A run of direction {direction} that was saved{with_it} goes on at its speed and that way when power comes on."""
    need_axis_lock(probe)
    if turned:
        probe.do(Verb.SET_DIRECTION, {"motor_direction": 1})
    before = _run_and_save(probe, direction)
    motion.stand_still(probe)
    after = _speed_after_power(probe)
    text = "a saved run does not go on when power comes on"
    probe.expect(after, near=before, within=2, unit="rpm", refutes=text)


@_of_kept_run("a shaft that turns", each=_saves, name="{command}/clean")
def _cleaned(probe: Probe) -> None:
    """A run that was cleaned does not begin when power comes on."""
    _run_and_save(probe, 0)
    _save(probe, "clean")
    _expect_no_run(probe, "the shaft turns at power-on although its run was cleaned")


@_of_kept_run("a shaft that turns", each=_saves, name="{command}/none", own=lambda case: ())
def _never_saved(probe: Probe) -> None:
    """Without a saved run nothing turns when power comes on."""
    motion.ready_to_move(probe)
    motion.run_at(probe, 90, QUICK)
    probe.wait(500 * MS)
    _expect_no_run(probe, "the shaft turns at power-on although no run was saved")


# --- the lock and the restart -----------------------------------------------------------------------------------------


def _locks(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.SET_AXIS_LOCK)(dialect):
        for value, word in ((0, "disabled"), (1, "enabled")):
            yield Case(dialect, case.command, {"value": value, "word": word})


@of_motion(
    each=_locks, name="{command}/at-power-on-{value}", refuted_by="the other state", emulated=True, settings=("axis_lock",)
)
def _locked(probe: Probe, command: Command, value: int) -> None:
    """With axis_lock {value} the motor is {word} when power comes on in a bus mode, and when a bus mode is set."""
    motion.ready_to_move(probe)
    probe.do(command, {"axis_lock": value})
    bench.power_cycle(probe)
    probe.wait(_START_NS)
    text = f"with axis_lock {value} the motor is in the other state at power-on"
    probe.expect(probe.read(Verb.READ_ENABLED, "enabled"), equal=value, refutes=text)
    bench.expect_hold(probe, bool(value), f"with axis_lock {value} at power-on")
    modes = probe.command(Verb.SET_WORK_MODE)
    buses = motion.bus_modes(probe.dialect)
    by_pulses = next(m for m in motion.field_of(modes, "work_mode").choice_names.values() if m not in buses)
    for mode in buses:
        motion.set_mode(probe, by_pulses)
        exchange = probe.do(modes, {"work_mode": motion.choice(modes, "work_mode", mode)})
        probe.wait(_START_NS)
        text = f"with axis_lock {value} the motor is in the other state when {mode} is set"
        probe.expect(probe.read(Verb.READ_ENABLED, "enabled"), equal=value, refutes=text, exchange=exchange)


def _restarts(dialect: Dialect) -> Iterator[Case]:
    """Yield the restart in the work mode of the suite, which is the last one by the bus, and in each of the others."""
    for case in commands(Verb.RESTART)(dialect):
        yield Case(dialect, case.command, {"mode": "", "where": "", "in_mode": ""})
        for mode in motion.bus_modes(dialect)[:-1]:
            yield Case(dialect, case.command, {"mode": mode, "where": f"-{mode}", "in_mode": f" in {mode}"})


@of_motion(
    each=_restarts,
    name="{command}/ends-motion{where}",
    statement="A restart ends a motion{in_mode}, and it is not taken up again.",
    refuted_by="a shaft that still turns",
    risks=risks_by(Verb.RUN_SPEED),
    parameters={},
    at_best=Certainty.LIKELY,
)
def _ends_motion(probe: Probe, command: Command, mode: str) -> None:
    motion.ready_to_move(probe, mode)
    motion.run_at(probe, 60, QUICK)
    probe.wait(500 * MS)
    exchange = probe.ask(command)
    wait_for_answer(probe)
    probe.wait(_RESUMES_NS)
    seen = motion.speed(probe)
    stands = abs(seen.value) < 1 + seen.noise
    if not stands:
        motion.stop(probe)
    text = "a run goes on after a restart"
    probe.expect(seen, holds=stands, expected="0 rpm", unit="rpm", refutes=text, exchange=exchange)
