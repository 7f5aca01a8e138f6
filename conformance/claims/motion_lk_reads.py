"""What LK motors say of themselves: angle, position, speed, voltage, temperature, phases.

Rules kept here:
- Two readings that tell the same are held against each other: 92 and 94 within a turn, the speed and the change of the
  position.
- Voltage and temperature need a hand on the drive: those claims are of emulated ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.motion_claim import motion_claim, refute
from conformance.claims.motion_lk import NEAR
from conformance.claims.motion_lk_speeds import measured, run
from conformance.claims.world import lk_drive
from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.probe import Probe

#: Angles by which the shaft is turned before something is read, in degrees: no two alike within a turn.
PLACES = (37.3, 101.7, 203.1, -171.9, 59.4)
_EDGES = (9_000, -3_600_050, 2_147_480_000, -2_147_480_000)
_TORQUE = 60


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about what an LK motor reads."""
    named = dialect.by_name
    spin = named["run_speed"].all_risks
    yield from _about_position(dialect)
    yield motion_claim(
        dialect, named["read_state_2"], "speed-is-change", "The speed that is read is that at which the position changes.",
        "another speed, or another sign", _speed_is_change, risks=spin, at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield motion_claim(
        dialect, named["run_speed"], "tells-speed", "A speed command is answered with the speed that the shaft has.",
        "another speed", _reply_tells_speed,
    )  # fmt: skip
    state = named["read_state_1"]
    yield motion_claim(
        dialect, state, "voltage", "The voltage is that of the supply, in 0.01 V.", "another voltage", _voltage,
        emulated=True, still=True,
    )  # fmt: skip
    yield motion_claim(
        dialect, state, "temperature", "The temperature is that of the motor in degC, below zero too.", "another one",
        _temperature, emulated=True, still=True,
    )  # fmt: skip
    yield motion_claim(
        dialect, state, "plausible", "The voltage is one that a drive can have: 5 to 60 V.", "another voltage", _plausible,
        at_best=Certainty.LIKELY, still=True,
    )  # fmt: skip
    phases = named.get("read_state_3")
    if phases is not None:
        yield motion_claim(
            dialect, phases, "balance", "The three phase currents add up to nothing, and are not all alike.",
            "currents that do not balance", _balance, models=phases.models,
            risks={Risk.UNBOUNDED, Risk.TORQUE}, at_best=Certainty.LIKELY,
        )  # fmt: skip


# --- position and angle -----------------------------------------------------------------------------------------------


def _about_position(dialect: Dialect) -> Iterator[Claim]:
    named = dialect.by_name
    single, setting, clear = named["read_single_turn"], named["set_position"], named["clear_turns"]
    yield motion_claim(
        dialect, single, "is-position", "The angle within the turn changes as the position does, around the turn.",
        "another change", _angle_is_position,
    )  # fmt: skip
    yield motion_claim(
        dialect, single, "within-turn", "The angle within the turn stays within 0 and 359.99 degrees.", "another angle",
        _within_turn,
    )  # fmt: skip
    made = partial(motion_claim, dialect, setting, settings=("position",))
    yield made("reads", "After 95 the position reads what was set, above and below zero.", "another position", _set_reads)
    yield made("stands", "95 turns nothing.", "a shaft that moved", _set_stands)
    yield made(
        "counts-on", "From what 95 set the position counts on, beyond 32 bits too.", "a position that begins anew",
        _counts_on,
    )  # fmt: skip
    yield made("and-moves", "A move to a position goes by what 95 set.", "another place", _set_moves, at_best=Certainty.LIKELY)
    yield motion_claim(
        dialect, clear, "drops-turns", "After 93 the position is within a turn.", "turns that are still counted",
        _clears_turns, at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield motion_claim(
        dialect, clear, "stands", "93 turns nothing, and leaves the angle within the turn.", "another angle", _clear_stands,
        at_best=Certainty.LIKELY,
    )  # fmt: skip


def turn_by(probe: Probe, degrees: float) -> None:
    """Turn the shaft by an angle and wait until it stands."""
    probe.do("move_increment_limited", {"position": round(degrees * 100), "max_speed": 36_000})
    probe.wait(int(abs(degrees) / 360 * SECOND_NS))
    motion.wait_standing(probe)


def angle(probe: Probe) -> float:
    """Return the angle within the turn, in degrees."""
    return probe.read(Verb.READ_SINGLE_TURN, "angle") / 100


def around(degrees: float) -> float:
    """Return an angle as the shortest way, -180..180."""
    return (degrees + 180) % 360 - 180


def _angle_is_position(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for degrees in PLACES:
        angle_before, place_before = angle(probe), motion.position(probe).value
        turn_by(probe, degrees)
        turned, moved = angle(probe) - angle_before, motion.position(probe).value - place_before
        if abs(around(turned - moved)) > NEAR:
            text = "the angle within the turn does not change as the position does"
            raise refute(probe.traffic[-1], text, expected=f"{around(moved):+.2f} degrees", got=f"{around(turned):+.2f}")


def _within_turn(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for degrees in (200.0, 200.0, -300.0, -300.0):
        turn_by(probe, degrees)
        exchange = probe.ask(command)
        seen = probe.reply(exchange).values["angle"]
        if not 0 <= seen <= 35_999:
            text = "the angle within the turn is outside of it"
            raise refute(exchange, text, expected="0..35999", got=str(seen))


def position(probe: Probe) -> int:
    """Return the position over all turns, in 0.01 degrees."""
    return probe.read(Verb.READ_POSITION, "position")


def _set_reads(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for value in _EDGES:
        exchange = probe.do(command, {"position": value})
        seen = position(probe)
        if abs(seen - value) > NEAR * 100:
            text = "the position does not read what 95 set"
            raise refute(exchange, text, expected=str(value), got=str(seen))


def _set_stands(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    before = angle(probe)
    exchange = probe.do(command, {"position": 9_000})
    probe.wait(SECOND_NS)
    turned = around(angle(probe) - before)
    if abs(turned) > NEAR:
        raise refute(exchange, "95 turns the shaft", expected="no motion", got=f"{turned:+.2f} degrees")


def _counts_on(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for value, degrees in ((9_000, 90.0), (2_147_480_000, 90.0), (-2_147_480_000, -90.0), (-5_000, -90.0)):
        exchange = probe.do(command, {"position": value})
        turn_by(probe, degrees)
        seen, wanted = position(probe), value + round(degrees * 100)
        if abs(seen - wanted) > NEAR * 100:
            text = "the position does not count on from what 95 set"
            raise refute(exchange, text, expected=str(wanted), got=str(seen))


def _set_moves(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    exchange = probe.do(command, {"position": 100_000})
    before = angle(probe)
    probe.do("move_multi_turn_limited", {"position": 104_500, "max_speed": 27_000})
    probe.wait(SECOND_NS)
    motion.wait_standing(probe)
    turned = around(angle(probe) - before)
    if abs(turned - 45) > NEAR:
        text = "a move does not go by the position that 95 set"
        raise refute(exchange, text, expected="+45 degrees", got=f"{turned:+.2f} degrees")


def _away(probe: Probe) -> None:
    motion.ready_to_move(probe)
    turn_by(probe, 800.0)


def _clears_turns(probe: Probe, command: Command) -> None:
    _away(probe)
    if abs(position(probe)) < 72_000:
        raise Inconclusive("the turns were not counted before 93")
    exchange = probe.do(command)
    seen = position(probe)
    if abs(seen) > 36_000:
        raise refute(exchange, "93 does not drop the turns", expected="within 36000", got=str(seen))


def _clear_stands(probe: Probe, command: Command) -> None:
    _away(probe)
    before = angle(probe)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    turned = around(angle(probe) - before)
    if abs(turned) > NEAR:
        text = "93 changes the angle within the turn"
        raise refute(exchange, text, expected=f"{before:.2f} degrees", got=f"{turned:+.2f} degrees more")


# --- speed, voltage, temperature, phases ------------------------------------------------------------------------------


def _speed_is_change(probe: Probe, command: Command) -> None:
    for sent in (18_000, -18_000, 36_000):
        run(probe, sent)
        change, spread = measured(probe, 500 * MS)
        exchange = probe.ask(command)
        seen = probe.reply(exchange).values["speed"]
        motion.stand_still(probe)
        if abs(seen - change) > 3 + abs(change) / 50 + spread:
            text = "the speed that is read is not that at which the position changes"
            raise refute(exchange, text, expected=f"{change:+.0f} deg/s", got=f"{seen:+d} deg/s")


def _reply_tells_speed(probe: Probe, command: Command) -> None:
    for sent in (18_000, -36_000):
        run(probe, sent)
        exchange = probe.do(command, {"speed": sent})
        seen = probe.reply(exchange).values["speed"]
        motion.stand_still(probe)
        if abs(seen - sent / 100) > 5 + abs(sent) / 2_000:
            text = "the reply to a speed command does not tell the speed"
            raise refute(exchange, text, expected=f"about {sent / 100:+g} deg/s", got=f"{seen:+d} deg/s")


def _voltage(probe: Probe, command: Command) -> None:
    for volts in (23.45, 18.02):
        lk_drive(probe).supply(volts)
        exchange = probe.ask(command)
        seen = probe.reply(exchange).values["voltage"]
        if abs(seen - volts * 100) > 1:
            raise refute(exchange, "the voltage is another one", expected=f"{volts * 100:.0f}", got=str(seen))


def _temperature(probe: Probe, command: Command) -> None:
    for degrees in (41, -7):
        lk_drive(probe).hot(degrees)
        exchange = probe.ask(command)
        seen = probe.reply(exchange).values["temperature"]
        if seen != degrees:
            raise refute(exchange, "the temperature is another one", expected=str(degrees), got=str(seen))


def _plausible(probe: Probe, command: Command) -> None:
    exchange = probe.ask(command)
    seen = probe.reply(exchange).values["voltage"]
    if not 500 <= seen <= 6_000:
        raise refute(exchange, "no drive works at this voltage", expected="500..6000", got=str(seen))


def _balance(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do("run_torque", {"torque_current": _TORQUE})
    probe.wait(300 * MS)
    exchange = probe.ask(command)
    values = probe.reply(exchange).values
    motion.stand_still(probe)
    currents = [values[f"phase_{p}_current"] for p in "abc"]
    largest = max(abs(c) for c in currents)
    if largest < _TORQUE / 4:
        raise Inconclusive("no current flows")
    if abs(sum(currents)) > max(4, largest / 4):
        text = "the phase currents do not add up to nothing"
        raise refute(exchange, text, expected="a sum of 0", got=" + ".join(map(str, currents)))
