"""What LK motors say of themselves: angle, position, speed, encoder, voltage, temperature, phases; zero and power.

Rules kept here:
- Two readings that tell the same are held against each other: 92 and 94 within a turn, the encoder and the angle, the speed
  and the change of the position.
- Voltage, temperature and power-up need a hand on the drive: those claims are of emulated ones.
- 19 wears the flash; it is sent to emulated drives alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance import moving
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.claims.motion_lk import NEAR, measured, run
from conformance.claims.motion_lk_states import lk_drive
from conformance.exchange import Exchange
from conformance.moving import MS, SECOND_NS
from conformance.probe import Probe

#: Resolutions that the manual names: 14, 15 and 16 bits; of 18 bits the upper 16 are sent.
_WIDTHS = (14, 15, 16)
_JITTER = 1
#: Angles by which the shaft is turned before the encoder is read, in degrees: no two alike within a turn.
_PLACES = (37.3, 101.7, 203.1, -171.9, 59.4)
_EDGES = (9_000, -3_600_050, 2_147_480_000, -2_147_480_000)
_TORQUE = 60


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about what an LK motor reads."""
    named = dialect.by_name
    spin = named["run_speed"].all_risks
    yield from _about_position(dialect)
    yield from _about_encoder(dialect)
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
        emulated=True,
    )  # fmt: skip
    yield motion_claim(
        dialect, state, "temperature", "The temperature is that of the motor in degC, below zero too.", "another one",
        _temperature, emulated=True,
    )  # fmt: skip
    yield motion_claim(
        dialect, state, "plausible", "The voltage is one that a drive can have: 5 to 60 V.", "another voltage", _plausible,
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    phases = named.get("read_state_3")
    if phases is not None:
        yield motion_claim(
            dialect, phases, "balance", "The three phase currents add up to nothing, and are not all alike.",
            "currents that do not balance", _balance, models=phases.models,
            risks={Risk.UNBOUNDED, Risk.TORQUE}, at_best=Certainty.LIKELY,
        )  # fmt: skip
    yield from _about_power(dialect)


# --- position and angle -----------------------------------------------------------------------------------------------


def _about_position(dialect: Dialect) -> Iterator[Claim]:
    named = dialect.by_name
    angle, setting, clear = named["read_single_turn"], named["set_position"], named["clear_turns"]
    yield motion_claim(
        dialect, angle, "is-position", "The angle within the turn changes as the position does, around the turn.",
        "another change", _angle_is_position,
    )  # fmt: skip
    yield motion_claim(
        dialect, angle, "within-turn", "The angle within the turn stays within 0 and 359.99 degrees.", "another angle",
        _within_turn,
    )  # fmt: skip
    made = partial(motion_claim, dialect, setting, settings=("position",))
    yield made("reads", "After 95 the position reads what was set, above and below zero.", "another position", _set_reads)
    yield made("stands", "95 turns nothing.", "a shaft that moved", _set_stands)
    yield made(
        "counts-on", "From what 95 set the position counts on, beyond 32 bits too.", "a position that begins anew",
        _counts_on,
    )  # fmt: skip
    yield made(
        "and-moves", "A move to a position goes by what 95 set.", "another place", _set_moves, at_best=Certainty.LIKELY
    )
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
    moving.wait_standing(probe)


def _angle(probe: Probe) -> float:
    return probe.read(Verb.READ_SINGLE_TURN, "angle") / 100


def _around(degrees: float) -> float:
    """Return an angle as the shortest way, -180..180."""
    return (degrees + 180) % 360 - 180


def _angle_is_position(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for degrees in _PLACES:
        angle, position = _angle(probe), moving.position(probe).value
        turn_by(probe, degrees)
        turned, moved = _angle(probe) - angle, moving.position(probe).value - position
        if abs(_around(turned - moved)) > NEAR:
            text = "the angle within the turn does not change as the position does"
            raise refute(probe.traffic[-1], text, expected=f"{_around(moved):+.2f} degrees", got=f"{_around(turned):+.2f}")


def _within_turn(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for degrees in (200.0, 200.0, -300.0, -300.0):
        turn_by(probe, degrees)
        exchange = probe.ask(command)
        angle = probe.reply(exchange).values["angle"]
        if not 0 <= angle <= 35_999:
            text = "the angle within the turn is outside of it"
            raise refute(exchange, text, expected="0..35999", got=str(angle))


def _position(probe: Probe) -> int:
    return probe.read(Verb.READ_POSITION, "position")


def _set_reads(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for value in _EDGES:
        exchange = probe.do(command, {"position": value})
        seen = _position(probe)
        if abs(seen - value) > NEAR * 100:
            text = "the position does not read what 95 set"
            raise refute(exchange, text, expected=str(value), got=str(seen))


def _set_stands(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    before = _angle(probe)
    exchange = probe.do(command, {"position": 9_000})
    probe.wait(SECOND_NS)
    turned = _around(_angle(probe) - before)
    if abs(turned) > NEAR:
        raise refute(exchange, "95 turns the shaft", expected="no motion", got=f"{turned:+.2f} degrees")


def _counts_on(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for value, degrees in ((9_000, 90.0), (2_147_480_000, 90.0), (-2_147_480_000, -90.0), (-5_000, -90.0)):
        exchange = probe.do(command, {"position": value})
        turn_by(probe, degrees)
        seen, wanted = _position(probe), value + round(degrees * 100)
        if abs(seen - wanted) > NEAR * 100:
            text = "the position does not count on from what 95 set"
            raise refute(exchange, text, expected=str(wanted), got=str(seen))


def _set_moves(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    exchange = probe.do(command, {"position": 100_000})
    before = _angle(probe)
    probe.do("move_multi_turn_limited", {"position": 104_500, "max_speed": 27_000})
    probe.wait(SECOND_NS)
    moving.wait_standing(probe)
    turned = _around(_angle(probe) - before)
    if abs(turned - 45) > NEAR:
        text = "a move does not go by the position that 95 set"
        raise refute(exchange, text, expected="+45 degrees", got=f"{turned:+.2f} degrees")


def _away(probe: Probe) -> None:
    moving.ready_to_move(probe)
    turn_by(probe, 800.0)


def _clears_turns(probe: Probe, command: Command) -> None:
    _away(probe)
    if abs(_position(probe)) < 72_000:
        raise Inconclusive("the turns were not counted before 93")
    exchange = probe.do(command)
    seen = _position(probe)
    if abs(seen) > 36_000:
        raise refute(exchange, "93 does not drop the turns", expected="within 36000", got=str(seen))


def _clear_stands(probe: Probe, command: Command) -> None:
    _away(probe)
    before = _angle(probe)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    turned = _around(_angle(probe) - before)
    if abs(turned) > NEAR:
        text = "93 changes the angle within the turn"
        raise refute(exchange, text, expected=f"{before:.2f} degrees", got=f"{turned:+.2f} degrees more")


# --- the encoder ------------------------------------------------------------------------------------------------------


def _about_encoder(dialect: Dialect) -> Iterator[Claim]:
    read, state = dialect.by_name["read_encoder"], dialect.by_name["read_state_2"]
    yield motion_claim(
        dialect, read, "difference", "The encoder is its raw value less the offset, around its range.", "another value",
        _difference, at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield motion_claim(
        dialect, read, "follows", "A quarter of a turn is a quarter of the encoder's range, clockwise up.", "another change",
        _follows, at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield motion_claim(
        dialect, state, "encoder", "The encoder that the state tells is that of 90.", "another value", _same_encoder,
        at_best=Certainty.LIKELY, risks=dialect.by_name["motor_off"].all_risks,
    )  # fmt: skip
    yield motion_claim(
        dialect, read, "below-offset", "Below the offset the encoder goes on around its own range, not that of 16 bits.",
        "a value beyond the encoder's range", _below_offset, emulated=True, at_best=Certainty.LIKELY,
        quirks=known(dialect, "lk-encoder-wide-difference"), risks=dialect.by_name["set_zero"].all_risks,
    )  # fmt: skip


def _encoder(probe: Probe) -> tuple[dict[str, int], Exchange]:
    exchange = probe.ask("read_encoder")
    return dict(probe.reply(exchange).values), exchange


def _fits(values: dict[str, int], width: int) -> bool:
    """Say whether the three values fit an encoder of so many bits."""
    difference = (values["encoder_raw"] - values["encoder_offset"] - values["encoder"]) % (1 << width)
    return max(values.values()) < 1 << width and min(difference, (1 << width) - difference) <= _JITTER


def _difference(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    widths = set(_WIDTHS)
    for degrees in _PLACES:
        turn_by(probe, degrees)
        values, exchange = _encoder(probe)
        widths = {w for w in widths if _fits(values, w)}
        if not widths:
            got = f"{values['encoder']} beside raw {values['encoder_raw']} and offset {values['encoder_offset']}"
            text = "the encoder is not its raw value less the offset"
            raise refute(exchange, text, expected="raw - offset, around 14, 15 or 16 bits", got=got)


def _quarter(probe: Probe) -> int:
    """Turn the shaft by a quarter clockwise; return by how much the raw encoder changed, within 16 bits."""
    before, _ = _encoder(probe)
    turn_by(probe, 90.0)
    after, _ = _encoder(probe)
    return (after["encoder_raw"] - before["encoder_raw"]) % (1 << 16)


def _width(change: int) -> int | None:
    """Return how many bits an encoder has that changes so much in a quarter of a turn, None where none fits."""
    for width in _WIDTHS:
        scale = 1 << width
        off = (change - scale // 4) % scale
        if min(off, scale - off) <= scale // 500:
            return width
    return None


def _follows(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    widths = []
    for _ in range(4):
        change = _quarter(probe)
        widths.append(_width(change))
        if widths[-1] is None:
            listed = ", ".join(str((1 << w) // 4) for w in _WIDTHS)
            text = "a quarter of a turn is not a quarter of the encoder's range"
            raise refute(probe.traffic[-1], text, expected=f"+{listed}", got=f"{change:+d}")


def _same_encoder(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for degrees in _PLACES:
        turn_by(probe, degrees)
        # Off, the shaft stands still and is not held by a loop that trembles.
        probe.do(Verb.MOTOR_OFF)
        probe.wait(500 * MS)
        exchange = probe.ask(command)
        told = probe.reply(exchange).values["encoder"]
        values, _ = _encoder(probe)
        probe.do(Verb.MOTOR_ON)
        if abs(told - values["encoder"]) > _JITTER:
            text = "the state tells another encoder value than 90"
            raise refute(exchange, text, expected=str(values["encoder"]), got=str(told))


def _power_cycle(probe: Probe) -> None:
    lk_drive(probe).power_cycle(probe.gate.now_ns())
    probe.wait(500 * MS)
    moving.ready_to_move(probe)


def _below_offset(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    width = _width(_quarter(probe))
    if width is None:
        raise Inconclusive("the width of the encoder cannot be told")
    probe.do(Verb.SET_ZERO)
    _power_cycle(probe)
    turn_by(probe, -45.0)
    values, exchange = _encoder(probe)
    if values["encoder_raw"] >= values["encoder_offset"]:
        raise Inconclusive("the raw value is not below the offset")
    if _fits(values, width):
        return
    wide = (values["encoder_raw"] - values["encoder_offset"]) % (1 << 16)
    if values["encoder"] == wide and "lk-encoder-wide-difference" in probe.claim.quirks:
        probe.meets("lk-encoder-wide-difference")
        return
    wanted = (values["encoder_raw"] - values["encoder_offset"]) % (1 << width)
    text = "below its offset the encoder leaves its range"
    raise refute(exchange, text, expected=str(wanted), got=str(values["encoder"]))


# --- speed, voltage, temperature, phases ------------------------------------------------------------------------------


def _speed_is_change(probe: Probe, command: Command) -> None:
    for sent in (18_000, -18_000, 36_000):
        run(probe, sent)
        change, spread = measured(probe, 500 * MS)
        exchange = probe.ask(command)
        seen = probe.reply(exchange).values["speed"]
        moving.stand_still(probe)
        if abs(seen - change) > 3 + abs(change) / 50 + spread:
            text = "the speed that is read is not that at which the position changes"
            raise refute(exchange, text, expected=f"{change:+.0f} deg/s", got=f"{seen:+d} deg/s")


def _reply_tells_speed(probe: Probe, command: Command) -> None:
    for sent in (18_000, -36_000):
        run(probe, sent)
        exchange = probe.do(command, {"speed": sent})
        seen = probe.reply(exchange).values["speed"]
        moving.stand_still(probe)
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
    moving.ready_to_move(probe)
    probe.do("run_torque", {"torque_current": _TORQUE})
    probe.wait(300 * MS)
    exchange = probe.ask(command)
    values = probe.reply(exchange).values
    moving.stand_still(probe)
    currents = [values[f"phase_{p}_current"] for p in "abc"]
    largest = max(abs(c) for c in currents)
    if largest < _TORQUE / 4:
        raise Inconclusive("no current flows")
    if abs(sum(currents)) > max(4, largest / 4):
        text = "the phase currents do not add up to nothing"
        raise refute(exchange, text, expected="a sum of 0", got=" + ".join(map(str, currents)))


# --- power and zero ---------------------------------------------------------------------------------------------------


def _about_power(dialect: Dialect) -> Iterator[Claim]:
    named = dialect.by_name
    yield motion_claim(
        dialect, named["motor_on"], "at-power-up", "When power comes on the motor is on and obeys.", "state 10h, or no motion",
        _on_at_power_up, emulated=True,
    )  # fmt: skip
    yield motion_claim(
        dialect, named["set_position"], "lost", "What 95 set is gone when power was off.", "the position that was set",
        _set_position_lost, emulated=True,
    )  # fmt: skip
    zero = named["set_zero"]
    made = partial(motion_claim, dialect, zero, emulated=True, at_best=Certainty.LIKELY)
    yield made("answers-raw", "19 is answered with the raw encoder value.", "another value", _zero_raw)
    yield made("not-at-once", "19 leaves the angle as it is until power comes on again.", "another angle", _zero_not_at_once)
    yield made("at-power-up", "After 19 the angle is 0 there when power comes on again.", "another angle", _zero_holds)


def _on_at_power_up(probe: Probe, command: Command) -> None:
    probe.do(Verb.MOTOR_OFF)
    lk_drive(probe).power_cycle(probe.gate.now_ns())
    probe.wait(500 * MS)
    state = probe.read(Verb.READ_STATE_1, "state")
    if state != 0:
        raise refute(probe.traffic[-1], "the motor is not on at power-up", expected="00h", got=f"{state:02X}h")
    before = moving.position(probe)
    turn_by(probe, 45.0)
    went = moving.position(probe).value - before.value
    if abs(went - 45) > NEAR:
        text = "the motor does not obey at power-up"
        raise refute(probe.traffic[-1], text, expected="+45 degrees", got=f"{went:+.1f} degrees")


def _set_position_lost(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    probe.do(command, {"position": 1_234_500})
    _power_cycle(probe)
    seen = _position(probe)
    if abs(seen - 1_234_500) <= 18_000:
        raise refute(probe.traffic[-1], "what 95 set is still there", expected="a position within a turn", got=str(seen))


def _zero_raw(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    for degrees in (77.0, 50.0):
        turn_by(probe, degrees)
        exchange = probe.do(command)
        told = probe.reply(exchange).values["encoder_zero"]
        values, _ = _encoder(probe)
        if abs(told - values["encoder_raw"]) > _JITTER:
            text = "19 is answered with another value than the raw one"
            raise refute(exchange, text, expected=str(values["encoder_raw"]), got=str(told))
        _power_cycle(probe)


def _zero_not_at_once(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    turn_by(probe, 77.0)
    before, angle = moving.position(probe), _angle(probe)
    exchange = probe.do(command)
    expect_stays(before, moving.position(probe), exchange, "19 changes the position at once")
    seen = _angle(probe)
    if abs(_around(seen - angle)) > NEAR:
        raise refute(exchange, "19 changes the angle at once", expected=f"{angle:.2f} degrees", got=f"{seen:.2f} degrees")


def _zero_holds(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    turn_by(probe, 77.0)
    exchange = probe.do(command)
    _power_cycle(probe)
    seen = _around(_angle(probe))
    if abs(seen) > NEAR:
        text = "the zero of 19 is not there when power comes on again"
        raise refute(exchange, text, expected="0 degrees", got=f"{seen:+.2f} degrees")
