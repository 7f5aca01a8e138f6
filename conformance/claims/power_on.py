"""Power-on: the way back to a kept zero (9A), a kept run (FF), whether the shaft is held (CAN), and the restart (41).

Power is cut of emulated drives alone; a kept run would turn a real motor as soon as power comes on.

Rules kept here:
- The way back is less than a turn; where the shaft stood before does not matter to it but within the turn.
- 3B reads 0 on the way and 1 when it is over.
- A drive may take two seconds to start.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Claim, Inconclusive
from conformance.claims import world
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.probe import Probe

_START_NS = 3 * SECOND_NS
#: How long the way back takes at the slowest: less than a turn.
_BACK_NS = 20 * SECOND_NS
_JITTER = 3
_OFF, _BY_DIRECTION, _NEAR = 0, 1, 2
_CW, _CCW = 0, 1


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about power-on."""
    run = dialect.by_verb[Verb.RUN_SPEED]
    zero = dialect.by_verb.get(Verb.SET_ZERO_MODE)
    if zero is not None:
        yield from _about_zero(dialect, zero)
    save = dialect.by_verb[Verb.SAVE_SPEED]
    made = partial(motion_claim, dialect, save, emulated=True, risks=run.all_risks)
    for direction in (0, 1):
        yield made(
            f"runs-direction-{direction}",
            f"A run of direction {direction} that was saved goes on at its speed and that way when power comes on.",
            "no run, another speed, or the other way",
            partial(_saved_run, direction),
        )
    yield made("clean", "A run that was cleaned does not begin when power comes on.", "a shaft that turns", _cleaned)
    made = partial(motion_claim, dialect, save, emulated=True, risks=run.all_risks, own=())
    yield made("none", "Without a saved run nothing turns when power comes on.", "a shaft that turns", _none_saved)
    lock = dialect.by_verb.get(Verb.SET_AXIS_LOCK)
    if lock is not None:
        for value in (0, 1):
            yield motion_claim(
                dialect,
                lock,
                f"at-power-on-{value}",
                f"With axis_lock {value} the motor is {'enabled' if value else 'disabled'} when power comes on in a bus mode.",
                "the other state",
                partial(_locked, value),
                emulated=True,
                settings=("axis_lock",),
            )
    restart = dialect.by_verb[Verb.RESTART]
    yield motion_claim(
        dialect,
        restart,
        "ends-motion",
        "A restart ends a motion, and it is not taken up again.",
        "a shaft that still turns",
        _restart_ends,
        risks=run.all_risks,
        at_best=Certainty.LIKELY,
    )


# --- the way back to zero ---------------------------------------------------------------------------------------------


def _about_zero(dialect: Dialect, zero: Command) -> Iterator[Claim]:
    made = partial(
        motion_claim,
        dialect,
        zero,
        emulated=True,
        settings=("zero_mode", "set_zero", "zero_speed", "zero_direction"),
        risks={Risk.POWER_ON},
    )
    for turns in (0.3, 0.7, -0.2):
        yield made(
            f"near-{turns:+g}".replace(".", "_"),
            f"In near mode a shaft {turns:+g} turns from its zero goes back the shorter way when power comes on.",
            "another place, or the longer way",
            partial(_back, _NEAR, _CW, turns),
            parameters={"turns": turns},
        )
    for direction, name in ((_CW, "cw"), (_CCW, "ccw")):
        yield made(
            f"direction-{name}",
            f"In direction mode {name} the shaft goes back to its zero {name}.",
            "another place, or the other way",
            partial(_back, _BY_DIRECTION, direction, 0.3),
        )
    yield made(
        "off", "With zero mode 0 nothing turns when power comes on.", "a shaft that turns", partial(_stays, _OFF, 1),
        risks=(), own=zero.risks({"zero_mode": _OFF}),
    )  # fmt: skip
    yield made(
        "clean",
        "Without a zero that was kept (set_zero 0) nothing turns when power comes on.",
        "a shaft that turns",
        partial(_stays, _NEAR, 0),
        at_best=Certainty.LIKELY,
    )
    yield made("faster", "A higher zero_speed brings the shaft back faster.", "one that takes as long, or longer", _faster)
    status = dialect.by_verb[Verb.READ_ZERO_STATUS]
    yield motion_claim(
        dialect,
        status,
        "tells",
        "3B reads 0 on the way back to zero and 1 when it is over.",
        "other numbers",
        _zero_status,
        emulated=True,
        settings=("zero_mode", "set_zero", "zero_speed", "zero_direction"),
        risks=zero.all_risks,
    )


def _keep_zero(probe: Probe, mode: int, direction: int, turns: float, speed: int = 4, keep: int = 1) -> float:
    """Keep where the shaft is as zero, go away from it and cut the power; return where the zero is (counts of its own)."""
    motion.ready_to_move(probe)
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    moves.travel(probe, move, 0.1)
    zero = world.shaft(probe)
    values = {"zero_mode": mode, "set_zero": keep, "zero_speed": speed, "zero_direction": direction}
    probe.do(Verb.SET_ZERO_MODE, values)
    moves.travel(probe, move, turns)
    world.power_cycle(probe)
    return zero


def _back(mode: int, direction: int, turns: float, probe: Probe, command: Command) -> None:
    zero = _keep_zero(probe, mode, direction, turns)
    probe.wait(_START_NS + _BACK_NS)
    if mode == _NEAR:
        expected = zero + round(turns) * COUNTS_PER_TURN
    else:
        expected = zero if direction == _CW else zero + COUNTS_PER_TURN
    at = world.shaft(probe)
    if abs(at - expected) > _JITTER:
        text = "the shaft does not go back to its zero as it was set"
        raise refute(probe.traffic[-1], text, expected=f"{expected:.0f} counts", got=f"{at:.0f} counts")


def _stays(mode: int, keep: int, probe: Probe, command: Command) -> None:
    _keep_zero(probe, mode, _CW, 0.3, keep=keep)
    before = world.shaft(probe)
    probe.wait(_START_NS + _BACK_NS)
    went = world.shaft(probe) - before
    if abs(went) > _JITTER:
        text = "the shaft goes back although there is no zero to go to"
        raise refute(probe.traffic[-1], text, expected="no motion", got=f"{went:+.0f} counts")


def _faster(probe: Probe, command: Command) -> None:
    took = []
    for speed in (0, 2, 4):
        zero = _keep_zero(probe, _NEAR, _CW, 0.4, speed)
        begun_ns = probe.gate.now_ns()
        moves.watch(probe, partial(_is_at, probe, zero), every_ns=5 * MS, limit_ns=_START_NS + _BACK_NS)
        took.append((probe.gate.now_ns() - begun_ns) / 1e6)
    if not took[0] > took[1] > took[2]:
        text = "a higher zero_speed does not bring the shaft back faster"
        got = ", ".join(f"{t:.0f} ms" for t in took)
        raise refute(probe.traffic[-1], text, expected="less time for each of 0, 2, 4", got=got)


def _is_at(probe: Probe, place: float) -> bool:
    return abs(world.shaft(probe) - place) <= _JITTER


def _zero_status(probe: Probe, command: Command) -> None:
    _keep_zero(probe, _NEAR, _CW, 0.49, 0)
    moves.watch(probe, lambda: not probe.ask(command, quiet_ns=0).silent, every_ns=50 * MS, limit_ns=5 * SECOND_NS)
    # The first answer since the start: at the slowest the way back takes a second.
    during = probe.reply(probe.traffic[-1]).values["status"]
    probe.wait(_BACK_NS)
    after = probe.read(command, "status")
    if (during, after) != (0, 1):
        text = "3B does not tell of the way back"
        raise refute(probe.traffic[-1], text, expected="0, then 1", got=f"{during}, then {after}")


# --- a kept run -------------------------------------------------------------------------------------------------------


def _save(probe: Probe, state: str) -> None:
    command = probe.command(Verb.SAVE_SPEED)
    probe.do(command, {"save_state": motion.choice(command, "save_state", state)})


def _run_and_save(probe: Probe, direction: int) -> float:
    """Run, save the run and stop; return the speed that the shaft had."""
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    motion.run_at(probe, -90 if direction else 90, QUICK)
    probe.wait(500 * MS)
    speed = motion.speed(probe).value
    if abs(speed) < 10:
        raise Inconclusive("the shaft does not turn before its run is saved")
    _save(probe, "save")
    return speed


def _after_power(probe: Probe) -> float:
    world.power_cycle(probe)
    probe.wait(_START_NS)
    return motion.speed(probe).value


def _saved_run(direction: int, probe: Probe, command: Command) -> None:
    before = _run_and_save(probe, direction)
    motion.stand_still(probe)
    after = _after_power(probe)
    if abs(after - before) > 2:
        text = "a saved run does not go on when power comes on"
        raise refute(probe.traffic[-1], text, expected=f"{before:+g} rpm", got=f"{after:+g} rpm")


def _expect_no_run(probe: Probe, what: str) -> None:
    after = _after_power(probe)
    if abs(after) >= 1:
        raise refute(probe.traffic[-1], f"the shaft turns at power-on {what}", expected="0 rpm", got=f"{after:+g} rpm")


def _cleaned(probe: Probe, command: Command) -> None:
    _run_and_save(probe, 0)
    _save(probe, "clean")
    _expect_no_run(probe, "although its run was cleaned")


def _none_saved(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, 90, QUICK)
    probe.wait(500 * MS)
    _expect_no_run(probe, "although no run was saved")


def _locked(value: int, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do(command, {"axis_lock": value})
    world.power_cycle(probe)
    probe.wait(_START_NS)
    seen = probe.read(Verb.READ_ENABLED, "enabled")
    if seen != value:
        text = f"with axis_lock {value} the motor reads {seen} at power-on"
        raise refute(probe.traffic[-1], text, expected=str(value), got=str(seen))


# --- the restart ------------------------------------------------------------------------------------------------------


def _restart_ends(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, 60, QUICK)
    probe.wait(500 * MS)
    exchange = probe.ask(command)
    probe.wait(_START_NS)
    seen = motion.speed(probe)
    if abs(seen.value) >= 1:
        motion.stop(probe)
        raise refute(exchange, "a run goes on after a restart", expected="0 rpm", got=f"{seen.value:g} rpm")
