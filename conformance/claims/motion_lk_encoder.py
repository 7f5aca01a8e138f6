"""The encoder of an LK motor, its zero, and what is left of it all when power comes on again.

Rules kept here:
- How many bits the encoder has is not on the wire: what 90 says must fit one of the widths that the manual names.
- 19 wears the flash, and its zero holds from power-up: it is sent to emulated drives alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.claims.motion_lk import NEAR
from conformance.claims.motion_lk_reads import PLACES, angle, around, position, turn_by
from conformance.claims.world import lk_drive
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: Resolutions that the manual names: 14, 15 and 16 bits; of 18 bits the upper 16 are sent.
_WIDTHS = (14, 15, 16)
_JITTER = 1


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about encoder, zero and power-up."""
    yield from _about_encoder(dialect)
    yield from _about_power(dialect)


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
    motion.ready_to_move(probe)
    widths = set(_WIDTHS)
    for degrees in PLACES:
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
    motion.ready_to_move(probe)
    widths = []
    for _ in range(4):
        change = _quarter(probe)
        widths.append(_width(change))
        if widths[-1] is None:
            listed = ", ".join(str((1 << w) // 4) for w in _WIDTHS)
            text = "a quarter of a turn is not a quarter of the encoder's range"
            raise refute(probe.traffic[-1], text, expected=f"+{listed}", got=f"{change:+d}")


def _same_encoder(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for degrees in PLACES:
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
    motion.ready_to_move(probe)


def _below_offset(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
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


# --- power and zero ---------------------------------------------------------------------------------------------------


def _about_power(dialect: Dialect) -> Iterator[Claim]:
    named = dialect.by_name
    yield motion_claim(
        dialect, named["set_position"], "lost", "What 95 set is gone when power was off.", "the position that was set",
        _set_position_lost, emulated=True,
    )  # fmt: skip
    zero = named["set_zero"]
    made = partial(motion_claim, dialect, zero, emulated=True, at_best=Certainty.LIKELY)
    yield made("answers-raw", "19 is answered with the raw encoder value.", "another value", _zero_raw)
    yield made("not-at-once", "19 leaves the angle as it is until power comes on again.", "another angle", _zero_not_at_once)
    yield made("at-power-up", "After 19 the angle is 0 there when power comes on again.", "another angle", _zero_holds)


def _set_position_lost(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do(command, {"position": 1_234_500})
    _power_cycle(probe)
    seen = position(probe)
    if abs(seen - 1_234_500) <= 18_000:
        raise refute(probe.traffic[-1], "what 95 set is still there", expected="a position within a turn", got=str(seen))


def _zero_raw(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
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
    motion.ready_to_move(probe)
    turn_by(probe, 77.0)
    before, kept = motion.position(probe), angle(probe)
    exchange = probe.do(command)
    expect_stays(before, motion.position(probe), exchange, "19 changes the position at once")
    seen = angle(probe)
    if abs(around(seen - kept)) > NEAR:
        raise refute(exchange, "19 changes the angle at once", expected=f"{kept:.2f} degrees", got=f"{seen:.2f} degrees")


def _zero_holds(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    turn_by(probe, 77.0)
    exchange = probe.do(command)
    _power_cycle(probe)
    seen = around(angle(probe))
    if abs(seen) > NEAR:
        text = "the zero of 19 is not there when power comes on again"
        raise refute(exchange, text, expected="0 degrees", got=f"{seen:+.2f} degrees")
