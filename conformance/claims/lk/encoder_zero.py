"""The encoder of an LK motor, the names that positions have, its zero, and what is left of it all when power comes on again.

Rules kept here:
- How many bits the encoder has is not on the wire: what 90 says must fit one of the widths that the manual names.
- 95 gives the place where the shaft stands another position, until power goes; 93 drops the counted turns.
- 19 wears the flash, and its zero holds from power-up: it is sent to emulated drives alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Verb
from conformance.claim import Inconclusive
from conformance.claims.bench import lk_drive
from conformance.claims.declare import Case, Cases
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import expect_speed, expect_stays, of_motion, risks_by
from conformance.claims.motion.reads import PLACES, angle, around, turn_by
from conformance.model.lk_parameters import need_room
from conformance.motion import arriving, motion
from conformance.motion.declared import CALM
from conformance.talk.exchange import Exchange
from conformance.talk.noise import Noise
from conformance.talk.probe import MS, SECOND_NS, Probe

#: Resolutions that the manual names: 14, 15 and 16 bits; of 18 bits the upper 16 are sent.
_WIDTHS = (14, 15, 16)
#: How far a position may be from what it should be, in degrees.
_NEAR = 0.25
#: How often a position is read that may tremble.
_LOOKS = 2


def named(name: str) -> Cases:
    """Return the case of a command by its name, in the dialect that has it and tells no counts of a turn."""
    return lambda dialect: (
        [Case(dialect, dialect.by_name[name])] if name in dialect.by_name and not dialect.counts_per_turn else []
    )


_set_position = partial(of_motion, each=named("set_position"), settings=("position",))
_clear_turns = partial(of_motion, each=named("clear_turns"), at_best=Certainty.LIKELY)
_read_encoder = partial(of_motion, each=named("read_encoder"), at_best=Certainty.LIKELY)
_zero = partial(of_motion, each=named("set_zero"), emulated=True, at_best=Certainty.LIKELY)


def _position(probe: Probe) -> int:
    """Return the position over all turns, as sent."""
    return probe.read(Verb.READ_POSITION, "position")


def _expect_angle(probe: Probe, since: float, turned: float, refutes: str, exchange: Exchange) -> None:
    """Refute unless the angle within the turn changed by so many degrees."""
    seen = around(angle(probe) - since)
    probe.expect(seen, near=turned, within=_NEAR, unit="degrees", refutes=refutes, exchange=exchange)


# --- the position by another name -------------------------------------------------------------------------------------


#: By which a shaft is brought to rest where it then holds its place (None: by nothing), and how far; what its place is called.
_HELD_BY, _BY, _CALLED = (None, "move_increment_limited", "move_multi_turn_limited"), 45, 4_321


@_set_position(refuted_by="a shaft that moved")
def _stands(probe: Probe, command: Command) -> None:
    """95 turns nothing: of a shaft that is only on, and of one that holds the place to which an increment or a move led it."""
    motion.ready_to_move(probe)
    for held_by in _HELD_BY:
        if held_by is not None:
            arriving.follow(probe, probe.command(held_by), _BY, rpm=CALM)
        before = angle(probe)
        exchange = probe.do(command, {"position": _position(probe) + _CALLED})
        probe.wait(SECOND_NS // 2)
        _expect_angle(probe, before, 0, "95 turns the shaft", exchange)


@_set_position(refuted_by="a position that begins anew")
def _counts_on(probe: Probe, command: Command) -> None:
    """From what 95 set the position counts on, beyond 32 bits too."""
    motion.ready_to_move(probe)
    for value, degrees in ((9_000, 90), (2_147_480_000, 90), (-2_147_480_000, -90), (-5_000, -90)):
        exchange = probe.do(command, {"position": value})
        turn_by(probe, degrees)
        text = "the position does not count on from what 95 set"
        seen, wanted = _position(probe) / 100, value / 100 + degrees
        probe.expect(seen, near=wanted, within=_NEAR, unit="degrees", refutes=text, exchange=exchange)


def _run_and_stop(probe: Probe) -> None:
    motion.run_at(probe, CALM)
    probe.wait(_RUNS_NS)
    motion.stand_still(probe)


#: How a motor comes into each state in which 95 is sent, and what its place is then called.
_STATES: Mapping[str, Callable[[Probe], object]] = {
    "on": motion.ready_to_move,
    "stopped": _run_and_stop,
    "off": lambda probe: motion.switch(probe, False),
}
_NAMES, _RUNS_NS = (-12_345, 67_891), 200 * MS


@_set_position(
    refuted_by="a position that is a little off in one state",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.RUN_SPEED, Verb.MOTOR_OFF),
)
def _to_the_digit(probe: Probe, command: Command) -> None:
    """What 95 sets is read to its last digit, below zero and above, of a motor that is on, stopped or off."""
    for state, bring in _STATES.items():
        bring(probe)
        motion.wait_standing(probe)
        offs, trembles = [], probe.noise.place
        text = f"95 sets another position of a motor that is {state}"
        for value in _NAMES:
            before = [_position(probe) for _ in range(_LOOKS)]
            exchange = probe.do(command, {"position": value})
            after = [_position(probe) for _ in range(_LOOKS)]
            trembles += sum(max(seen) - min(seen) for seen in (before, after)) / 100
            # It may rest beside its target, by as much whatever its place is called.
            offs.append((after[0] - value) / 100)
            probe.expect(after[0] / 100, near=value / 100, unit="degrees", refutes=text, exchange=exchange)
        below, above = offs
        probe.expect(below, near=above, within=trembles, unit="degrees", refutes=f"{text}: below zero and above")
    motion.switch(probe, True)


@_set_position(refuted_by="another place", at_best=Certainty.LIKELY, first=need_room)
def _and_moves(probe: Probe, command: Command) -> None:
    """A move to a position goes by what 95 set, above and below zero, either way."""
    motion.ready_to_move(probe)
    for value, degrees in ((100_000, 45), (-100_000, -45)):
        exchange = probe.do(command, {"position": value})
        before = angle(probe)
        arriving.follow(probe, probe.command("move_multi_turn_limited"), degrees, rpm=45, start=value)
        _expect_angle(probe, before, degrees, "a move does not go by the position that 95 set", exchange)


@_set_position(
    refuted_by="a run the other way, or a position that goes another way",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.RUN_SPEED),
)
def _and_runs(probe: Probe, command: Command) -> None:
    """A run after 95 turns the shaft either way as before it, and the position goes on from what was set."""
    motion.ready_to_move(probe)
    for value, way in ((100_000, -1), (-100_000, 1), (2_000, -1)):
        before = angle(probe)
        exchange = probe.do(command, {"position": value})
        motion.run_at(probe, way * CALM)
        probe.wait(300 * MS)
        motion.stand_still(probe)
        went = (_position(probe) - value) / 100
        text = "a run after 95 goes the other way, by the position"
        probe.expect(f"{went:+.1f} degrees", holds=went * way > 1, expected=f"{way:+d}", refutes=text, exchange=exchange)
        _expect_angle(probe, before + went, 0, "the angle and the position part in a run after 95", exchange)


@_set_position(refuted_by="another end", at_best=Certainty.OPEN)
def _under_way(probe: Probe, command: Command) -> None:
    """95 while an increment is under way leaves its end where it was."""
    motion.ready_to_move(probe)
    before = angle(probe)
    motion.begin(probe, probe.command("move_increment_limited"), 300, rpm=30)
    probe.wait(500 * MS)
    exchange = probe.do(command, {"position": 5_000})
    motion.wait_standing(probe)
    _expect_angle(probe, before + 300, 0, "95 during a move shifts its end", exchange)


@of_motion(each=named("set_position"), refuted_by="the position that was set", emulated=True)
def _lost(probe: Probe, command: Command) -> None:
    """What 95 set is gone when power was off."""
    motion.ready_to_move(probe)
    probe.do(command, {"position": 1_234_500})
    _power_cycle(probe)
    seen = _position(probe)
    gone = abs(seen - 1_234_500) > 18_000
    probe.expect(str(seen), holds=gone, expected="a position within a turn", refutes="what 95 set is still there")


def _away(probe: Probe, degrees: float = 800) -> None:
    """Turn the shaft by more than two turns."""
    motion.ready_to_move(probe)
    turn_by(probe, degrees)


@_clear_turns(refuted_by="turns that are still counted")
def _drops_turns(probe: Probe, command: Command) -> None:
    """After 93 the position is within a turn, after turns in either direction."""
    for degrees in (800, -1600):
        before = _position(probe)
        _away(probe, degrees)
        if abs(_position(probe) - before) < 72_000:
            raise Inconclusive("the turns were not counted before 93")
        exchange = probe.do(command)
        text = "93 does not drop the turns"
        seen = _position(probe) / 100
        probe.expect(seen, at_least=-360, at_most=360, unit="degrees", refutes=text, exchange=exchange)


@_clear_turns(name="{command}/keeps-angle", refuted_by="another angle within the turn", at_best=Certainty.LIKELY)
def _keeps_angle(probe: Probe, command: Command) -> None:
    """93 drops whole turns alone: what is left is where the shaft stands within the turn, by 92 of before or by 94."""
    for degrees in (470, -830):
        _away(probe, degrees)
        before = _position(probe)
        exchange = probe.do(command)
        after, wanted = _position(probe), (before, round(angle(probe) * 100))
        probe.expect(
            f"{after / 100:.2f}",
            holds=any(abs(around((after - one) / 100)) <= motion.miss(probe) for one in wanted),
            expected=" or ".join(f"{one / 100 % 360:.2f}" for one in dict.fromkeys(wanted)) + ", but for whole turns",
            refutes="93 drops more than the turns",
            exchange=exchange,
        )


@_clear_turns(refuted_by="turns that are still counted", risks=risks_by(Verb.RUN_SPEED))
def _while_turning(probe: Probe, command: Command) -> None:
    """93 drops the turns of a shaft that turns, and it turns on."""
    _away(probe)
    motion.run_at(probe, CALM)
    probe.wait(500 * MS)
    exchange = probe.do(command)
    place, turning = _position(probe) / 100, motion.speed(probe)
    motion.stand_still(probe)
    text = "93 does not drop the turns of a shaft that turns"
    probe.expect(place, at_least=-360, at_most=2 * 360, unit="degrees", refutes=text, exchange=exchange)
    expect_speed(turning, CALM, exchange, "93 changes the speed of the shaft", share=0.1)


@_clear_turns(name="{command}/stands", refuted_by="another angle")
def _clearing_stands(probe: Probe, command: Command) -> None:
    """93 turns nothing, and leaves the angle within the turn."""
    _away(probe)
    before = angle(probe)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    _expect_angle(probe, before, 0, "93 changes the angle within the turn", exchange)


# --- the encoder ------------------------------------------------------------------------------------------------------


def _encoder(probe: Probe) -> tuple[dict[str, int], Exchange]:
    exchange = probe.ask("read_encoder")
    return dict(probe.reply(exchange).values), exchange


def _fits(values: dict[str, int], width: int) -> bool:
    """Say whether the three values fit an encoder of so many bits."""
    difference = (values["encoder_raw"] - values["encoder_offset"] - values["encoder"]) % (1 << width)
    return max(values.values()) < 1 << width and min(difference, (1 << width) - difference) <= Noise.step("encoder")


@_read_encoder(refuted_by="another value")
def _difference(probe: Probe) -> None:
    """The encoder is its raw value less the offset, around its range."""
    motion.ready_to_move(probe)
    widths = set(_WIDTHS)
    for degrees in PLACES:
        turn_by(probe, degrees)
        values, exchange = _encoder(probe)
        widths = {w for w in widths if _fits(values, w)}
        probe.expect(
            f"{values['encoder']} beside raw {values['encoder_raw']} and offset {values['encoder_offset']}",
            holds=bool(widths),
            expected="raw - offset, around 14, 15 or 16 bits",
            refutes="the encoder is not its raw value less the offset",
            exchange=exchange,
        )


def _quarter(probe: Probe) -> int:
    """Turn the shaft by a quarter clockwise; return by how much the raw encoder changed, within 16 bits."""
    before, _ = _encoder(probe)
    turn_by(probe, 90)
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


@_read_encoder(refuted_by="another change")
def _follows(probe: Probe) -> None:
    """A quarter of a turn is a quarter of the encoder's range, clockwise up."""
    motion.ready_to_move(probe)
    for _ in range(4):
        change = _quarter(probe)
        probe.expect(
            f"{change:+d}",
            holds=_width(change) is not None,
            expected=f"+{', '.join(str((1 << w) // 4) for w in _WIDTHS)}",
            refutes="a quarter of a turn is not a quarter of the encoder's range",
        )


@of_motion(
    each=named("read_state_2"),
    name="{command}/encoder",
    refuted_by="another value",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.MOTOR_OFF),
)
def _same_encoder(probe: Probe, command: Command) -> None:
    """The encoder that the state tells is that of 90."""
    motion.ready_to_move(probe)
    for degrees in PLACES:
        turn_by(probe, degrees)
        # Off, the shaft stands still and is not held by a loop that trembles.
        motion.switch(probe, False)
        probe.wait(120 * MS)
        exchange = probe.ask(command)
        told = probe.reply(exchange).values["encoder"]
        values, _ = _encoder(probe)
        motion.switch(probe, True)
        text = "the state tells another encoder value than 90"
        probe.expect(told, near=values["encoder"], unit="encoder", refutes=text, exchange=exchange)


def _power_cycle(probe: Probe) -> None:
    lk_drive(probe).power_cycle(probe.gate.now_ns())
    probe.wait(500 * MS)
    motion.ready_to_move(probe)


@_read_encoder(
    refuted_by="a value beyond the encoder's range",
    emulated=True,
    quirks=may_meet("lk-encoder-wide-difference"),
    risks=risks_by(Verb.SET_ZERO),
)
def _below_offset(probe: Probe) -> None:
    """Below the offset the encoder goes on around its own range, not that of 16 bits."""
    motion.ready_to_move(probe)
    width = _width(_quarter(probe))
    if width is None:
        raise Inconclusive("the width of the encoder cannot be told")
    probe.do(Verb.SET_ZERO)
    _power_cycle(probe)
    turn_by(probe, -45)
    values, exchange = _encoder(probe)
    below = values["encoder_raw"] - values["encoder_offset"]
    if below >= 0:
        raise Inconclusive("the raw value is not below the offset")
    fits, wide = _fits(values, width), values["encoder"] == below % (1 << 16)
    if not fits and wide and "lk-encoder-wide-difference" in probe.claim.quirks:
        probe.meets("lk-encoder-wide-difference")
    else:
        text, wanted = "below its offset the encoder leaves its range", str(below % (1 << width))
        probe.expect(str(values["encoder"]), holds=fits, expected=wanted, refutes=text, exchange=exchange)


# --- the zero ---------------------------------------------------------------------------------------------------------


@_zero(refuted_by="another value")
def _answers_raw(probe: Probe, command: Command) -> None:
    """19 is answered with the raw encoder value."""
    motion.ready_to_move(probe)
    for degrees in (77, 50):
        turn_by(probe, degrees)
        exchange = probe.do(command)
        told = probe.reply(exchange).values["encoder_zero"]
        values, _ = _encoder(probe)
        text = "19 is answered with another value than the raw one"
        probe.expect(told, near=values["encoder_raw"], unit="encoder", refutes=text, exchange=exchange)
        _power_cycle(probe)


@of_motion(each=named("set_zero"), refuted_by="values that do not fit one another", at_best=Certainty.LIKELY)
def _fits_behind(probe: Probe, command: Command) -> None:
    """19 is answered with the raw value that 90 tells, and 90 behind it tells an encoder that is raw - offset."""
    motion.ready_to_move(probe)
    widths = set(_WIDTHS)
    for degrees in (77, 50):
        _encoder(probe)
        turn_by(probe, degrees)
        told = probe.reply(probe.do(command)).values["encoder_zero"]
        values, exchange = _encoder(probe)
        widths = {w for w in widths if _fits(values, w)}
        text, raw = "19 is answered with another value than the raw one", values["encoder_raw"]
        probe.expect(told, near=raw, unit="encoder", refutes=text, exchange=exchange, key="19 raw")
        text = "behind 19 the encoder is not its raw value less the offset"
        got = f"{values['encoder']} beside raw {raw} and offset {values['encoder_offset']}"
        expected = "raw - offset, around 14, 15 or 16 bits"
        probe.expect(got, holds=bool(widths), expected=expected, refutes=text, exchange=exchange, key="behind 19")


@_zero(refuted_by="another angle", at_best=Certainty.OPEN)
def _not_at_once(probe: Probe, command: Command) -> None:
    """19 leaves the angle as it is until power comes on again; it goes on with the shaft."""
    motion.ready_to_move(probe)
    turn_by(probe, 77)
    before, kept = motion.position(probe), angle(probe)
    exchange = probe.do(command)
    expect_stays(before, motion.position(probe), exchange, "19 changes the position at once")
    _expect_angle(probe, kept, 0, "19 changes the angle at once", exchange)
    turn_by(probe, 43)
    _expect_angle(probe, kept, 43, "the angle does not go on after 19", exchange)


@_zero(refuted_by="another angle")
def _at_power_up(probe: Probe, command: Command) -> None:
    """After 19 the angle is 0 there when power comes on again."""
    motion.ready_to_move(probe)
    turn_by(probe, 77)
    exchange = probe.do(command)
    _power_cycle(probe)
    _expect_angle(probe, 0, 0, "the zero of 19 is not there when power comes on again", exchange)


@_zero(refuted_by="another offset")
def _offset(probe: Probe, command: Command) -> None:
    """From the next power-up on the offset that 90 tells is the value that 19 was answered with."""
    motion.ready_to_move(probe)
    width = _width(_quarter(probe))
    if width is None:
        raise Inconclusive("the width of the encoder cannot be told")
    # At a third and at two thirds of a turn each bit of the encoder is once 0 and once 1.
    for thirds in (1, 2):
        values, _ = _encoder(probe)
        turn_by(probe, around(thirds * 120 - values["encoder_raw"] * 360 / (1 << width)))
        told = probe.reply(probe.do(command)).values["encoder_zero"]
        _power_cycle(probe)
        values, exchange = _encoder(probe)
        probe.expect(values["encoder_offset"], equal=told, refutes="90 tells another offset than 19 set", exchange=exchange)
        _expect_angle(probe, 0, 0, "the zero of 19 is not there when power comes on again", exchange)
