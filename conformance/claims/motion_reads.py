"""Reads: that what the drive says of position, speed, pulses and error is what the shaft does, and that the numbers agree.

Two numbers that tell the same are held against each other (30 and 31, 31 and 32, 31 and 33), so that a wrong one shows
whatever moved the shaft.

Rules kept here:
- A turn is 16384 counts of the encoder and 3200 pulses at 16 subdivisions.
- Both sides of zero are looked at: a sign or a width that is wrong often shows only there.
- An angle error needs a shaft that is held: an emulated drive's can be.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Aspect, Claim, Inconclusive, Theme
from conformance.claims import world
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.motion.motion import mean_speed as measured
from conformance.talk.probe import Probe

_RPM = 120
#: More counts than 24 signed bits hold, in turns.
_WIDE_TURNS = 600
#: A jitter of the encoder, in counts, and in degrees of error.
_JITTER, _LAG = 2, 1.0
#: What the version tells of the bare encoder.
_CW_RAISES, _CW_LOWERS = 1, 2


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about what is read of a shaft that moves."""
    verbs = dialect.by_verb
    run, pulses = verbs[Verb.RUN_SPEED].all_risks, verbs[Verb.MOVE_RELATIVE_PULSES].all_risks
    position, carry = verbs[Verb.READ_POSITION], verbs[Verb.READ_ENCODER_CARRY]
    yield motion_claim(
        dialect,
        position,
        "turn",
        "A turn of the shaft (3200 pulses at 16 subdivisions) changes the position by 16384.",
        "another change",
        _turn,
        risks=pulses,
    )
    yield motion_claim(
        dialect,
        carry,
        "is-position",
        "Carry x 16384 + value is the position, above and below zero and beyond a turn; the value stays within one.",
        "two numbers that differ, or a value beyond a turn",
        _carry_is_position,
        risks=pulses,
    )
    yield motion_claim(
        dialect,
        position,
        "wide",
        f"The position counts on over {_WIDE_TURNS} turns: more than 24 bits hold.",
        "a position that begins anew",
        _wide,
        risks=run,
    )
    yield motion_claim(
        dialect,
        verbs[Verb.READ_SPEED],
        "is-change",
        "The speed that is read is that at which the position changes, rising positions being positive.",
        "another speed, or another sign",
        _speed_is_change,
        at_best=Certainty.LIKELY,
        risks=run,
        quirks=known(dialect, "slow-replies-in-motion"),
    )
    yield motion_claim(
        dialect, verbs[Verb.READ_SPEED], "at-rest", "The speed of a shaft that stands is 0.", "another speed", _speed_at_rest,
        risks=run,
    )  # fmt: skip
    yield motion_claim(
        dialect,
        verbs[Verb.READ_PULSES],
        "counts-moves",
        "The count of pulses changes by the pulses of a move, up for one direction and down for the other.",
        "another number, or the same way for both",
        _pulses_count,
        risks=pulses,
    )
    error = verbs[Verb.READ_ANGLE_ERROR]
    yield motion_claim(
        dialect, error, "at-rest", "The angle error of a shaft that stands where it should is about 0.",
        f"more than {_LAG:g} degree", _error_at_rest,
    )  # fmt: skip
    for turns in (0.25, -0.25, 1.5, -1.5):
        yield motion_claim(
            dialect,
            error,
            f"held-{turns:+g}".replace(".", "_"),
            f"With the shaft held and a move by {turns:+g} turns, the angle error is {turns * 360:+g} degrees: "
            "51200 units are a turn, and what is wanted beyond the shaft is positive.",
            "another number",
            partial(_error_held, turns),
            emulated=True,
            settings=("protection",),
            risks=verbs[Verb.SET_PROTECTION].all_risks,
            parameters={"turns": turns},
        )
    version = verbs.get(Verb.READ_VERSION)
    if version is not None:
        yield declare(
            dialect,
            Theme.MOTION,
            f"{version.name}/calibration",
            "The version tells that turning clockwise lowers the bare encoder, as it lowers what 31 reads.",
            "the other sense",
            _calibration,
            command=version,
            aspect=Aspect.STATE,
            rests_on=(Doubt.SIGN,),
            at_best=Certainty.OPEN,
            quirks=known(dialect, "version-cal-1"),
        )
    reads = tuple(c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.fields)
    for command in reads:
        yield motion_claim(
            dialect,
            command,
            "while-moving",
            f"{command.name} is answered while the motor turns.",
            "silence",
            _answered_while_moving,
            risks=run,
            models=command.models,
        )


def _counts(probe: Probe) -> int:
    return probe.read(Verb.READ_POSITION, "position")


def _by_pulses(probe: Probe, turns: float) -> None:
    moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), turns, speed=180, acceleration=QUICK)


def _turn(probe: Probe, command: Command) -> None:
    moves.prepare(probe, probe.command(Verb.MOVE_RELATIVE_PULSES))
    for turns in (1, -1):
        before = _counts(probe)
        _by_pulses(probe, turns)
        change = _counts(probe) - before
        if abs(abs(change) - COUNTS_PER_TURN) > _JITTER:
            text = "a turn of the shaft is another number of counts"
            raise refute(probe.traffic[-1], text, expected=str(COUNTS_PER_TURN), got=str(abs(change)))


def _carry_is_position(probe: Probe, command: Command) -> None:
    moves.prepare(probe, probe.command(Verb.MOVE_RELATIVE_PULSES))
    for turns in (-0.4, 1.7, 1.0, -3.0):
        _by_pulses(probe, turns)
        exchange = probe.ask(command)
        values = probe.reply(exchange).values
        together, counts = values["carry"] * COUNTS_PER_TURN + values["encoder"], _counts(probe)
        if not 0 <= values["encoder"] < COUNTS_PER_TURN:
            got = str(values["encoder"])
            raise refute(exchange, "the value is more than a turn", expected=f"0..{COUNTS_PER_TURN - 1}", got=got)
        if abs(together - counts) > _JITTER:
            raise refute(
                exchange,
                "carry and value are not the position",
                expected=f"{counts}, as read_position has it",
                got=f"{values['carry']} x 16384 + {values['encoder']} = {together}",
            )


def _wide(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, motion.bus_modes(probe.dialect)[-1], subdivision=moves.SUBDIVISION)
    duration_ns = int(_WIDE_TURNS / 3000 * 60 * SECOND_NS)
    for direction in (0, 1, 1):
        before = motion.position(probe)
        exchange = probe.do(Verb.RUN_SPEED, {"direction": direction, "speed": 3000, "acceleration": 255})
        probe.wait(duration_ns)
        motion.stop(probe, QUICK)
        after = motion.wait_standing(probe)
        change = abs(after.value - before.value) / 360
        if not _WIDE_TURNS * 0.97 < change < _WIDE_TURNS * 1.2:
            text = "the position does not count on"
            raise refute(exchange, text, expected=f"about {_WIDE_TURNS} turns", got=f"{change:.0f} turns")


def _speed_is_change(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    for rpm in (_RPM, -_RPM, 300):
        motion.run_at(probe, rpm, QUICK)
        probe.wait(300 * MS)
        change, spread = measured(probe, 500 * MS)
        exchange = probe.ask(command)
        seen = motion.speed(probe).value
        motion.stand_still(probe)
        if spread > abs(rpm) / 10:
            if "slow-replies-in-motion" not in probe.claim.quirks:
                raise Inconclusive("the replies came too late to measure a speed")
            probe.meets("slow-replies-in-motion")
        if abs(seen - change) > 2 + abs(change) / 100 + spread:
            raise refute(
                exchange,
                "the speed that is read is not that at which the position changes",
                expected=f"{change:+.1f} rpm +-{spread:.1f}",
                got=f"{seen:+g} rpm",
            )


def _speed_at_rest(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(300 * MS)
    motion.stop(probe, QUICK)
    probe.wait(SECOND_NS)
    before = motion.position(probe)
    seen = motion.speed(probe)
    after = motion.position(probe)
    if abs(after.value - before.value) > motion.SAME:
        raise Inconclusive("the shaft does not stand")
    if abs(seen.value) >= 1:
        text = "the shaft stands and its speed is not 0"
        raise refute(probe.traffic[-1], text, expected="0 rpm", got=f"{seen.value:g} rpm")


def _pulses_count(probe: Probe, command: Command) -> None:
    moves.prepare(probe, probe.command(Verb.MOVE_RELATIVE_PULSES))
    changes = []
    for turns in (0.3, -0.7, 1.5):
        before = probe.read(command, "pulses")
        _by_pulses(probe, turns)
        changes.append(probe.read(command, "pulses") - before)
        wanted = round(abs(turns) * 3200)
        if abs(abs(changes[-1]) - wanted) > 1:
            text = "the count of pulses does not change by those of the move"
            raise refute(probe.traffic[-1], text, expected=str(wanted), got=str(abs(changes[-1])))
    if changes[0] * changes[1] > 0:
        text = "the count of pulses changes the same way for both directions"
        raise refute(probe.traffic[-1], text, expected="two ways", got=f"{changes[0]:+d} and {changes[1]:+d}")


# --- the angle error --------------------------------------------------------------------------------------------------


def _degrees(probe: Probe, command: Command) -> float:
    field = command.reply_forms[0].layout.named["angle_error"]
    return float(field.physical(probe.read(command, "angle_error")))


def _error_at_rest(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.25)
    seen = _degrees(probe, command)
    if abs(seen) > _LAG:
        text = "a shaft that is where it should be has an angle error"
        raise refute(probe.traffic[-1], text, expected="about 0 degrees", got=f"{seen:+.2f} degrees")


def _error_held(turns: float, probe: Probe, command: Command) -> None:
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    moves.prepare(probe, move)
    probe.do(Verb.SET_PROTECTION, {"protection": 0})
    world.hold(probe)
    moves.begin(probe, move, turns, acceleration=QUICK)
    probe.wait(3 * SECOND_NS)
    seen = _degrees(probe, command)
    if abs(seen - turns * 360) > _LAG:
        text = "the angle error of a shaft that is held is not what is missing"
        raise refute(probe.traffic[-1], text, expected=f"{turns * 360:+g} degrees", got=f"{seen:+.2f} degrees")


def _calibration(probe: Probe) -> None:
    seen = probe.read(Verb.READ_VERSION, "calibration")
    if seen == _CW_RAISES and "version-cal-1" in probe.claim.quirks:
        probe.meets("version-cal-1")
    elif seen != _CW_LOWERS:
        text = "the version tells another sense of the encoder"
        raise refute(probe.traffic[-1], text, expected=str(_CW_LOWERS), got=str(seen))


# --- while it turns ---------------------------------------------------------------------------------------------------


def _answered_while_moving(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    if probe.ask(command).silent:
        raise Inconclusive(f"{command.name} is not answered at rest either")
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(300 * MS)
    exchanges = [probe.ask(command) for _ in range(2)]
    if all(e.silent for e in exchanges):
        # Whether it stands cannot be seen where nothing is answered.
        motion.stop(probe, QUICK)
        text = f"{command.name} is not answered while the motor turns"
        raise refute(exchanges[0], text, expected="a reply", got="silence")
    motion.stand_still(probe)
