"""Read-back of LK drives: control parameters, positions, zero and brake: what is written is read, and how long it holds.

    parameter/NAME/written    0xC1 answers what it holds, and 0xC0 reads it           others    no other changes
    parameter/NAME/power      it is gone with the power (emulated)                     set_position/power    so is a position
    set_zero/...              0x19 stores the raw encoder; it holds from the next power-up
    clear_turns, brake, encoder, single turn, positions beyond 32 bits

Rules kept here:
- Values are moderate: what a drive does at the ends of their types is open (`ranges_lk`).
- A firmware without 0xC0 and 0xC1 was seen: those claims observe it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Form, Risk, Verb
from conformance import moving
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.ranges_lk import MODERATE, OTHER_FIRMWARE, SAME, read_parameter
from conformance.claims.restarts import power_cycle
from conformance.probe import Probe

WIDE_DIFFERENCE = "lk-encoder-wide-difference"
#: Hundredths of a degree of a turn, and those in which two positions are one.
TURN, PLAY = 36_000, int(SAME * 100)
#: Values of limits and ramps that need three bytes, no two of them alike, within what a drive may be set to.
_MODERATE = {
    "torque_limit": (600, 900), "speed_limit": (0x01_2345, 0x01_0F23), "angle_limit": (0x2134_5678, 0x1134_5678),
    "current_ramp": (0x01_2345, 0x02_1436), "speed_ramp": (0x06_1234, 0x05_2143),
}  # fmt: skip
_GAINS = {"kp": (0x0164, 0x0232), "ki": (0x0119, 0x0226), "kd": (0x0102, 0x0203)}


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for LK drives."""
    verbs = dialect.by_verb
    if Verb.WRITE_PARAMETER not in verbs:
        return
    forms = [f for f in verbs[Verb.WRITE_PARAMETER].request_forms if f.layout.named["parameter"].fixed is not None]
    for form in forms:
        yield from _parameter(dialect, verbs[Verb.WRITE_PARAMETER], form, forms)
    yield from _positions(dialect)
    yield from _zero(dialect)
    yield from _encoder(dialect)
    yield _brake(dialect)


def number_of(form: Form) -> int:
    """Return the number of the parameter that a form is about."""
    return form.layout.named["parameter"].fixed or 0


def moderate(form: Form, which: int) -> dict[str, int]:
    """Return the first or second set of moderate values of a parameter."""
    values = {}
    for name, field in form.layout.named.items():
        if field.fixed is not None:
            values[name] = field.fixed
        else:
            values[name] = (_MODERATE.get(name) or _GAINS[name.rpartition("_")[2]])[which]
    return values


# --- parameters -------------------------------------------------------------------------------------------------------


def _parameter(dialect: Dialect, command: Command, form: Form, forms: list[Form]) -> Iterator[Claim]:
    number = number_of(form)
    needs: dict[str, Any] = {
        "risks": command.risks({"parameter": number}), "settings": (form.name,), "quirks": (OTHER_FIRMWARE,),
        "fields": tuple(n for n, f in form.layout.named.items() if f.fixed is None),
    }  # fmt: skip

    def written(probe: Probe) -> None:
        before = read_parameter(probe, number)
        for which in (0, 1):
            wanted = moderate(form, which)
            exchange = probe.ask(command, wanted, form=form)
            told = {n: int(v) for n, v in probe.reply(exchange).values.items()}
            held = read_parameter(probe, number)
            probe.do(command, before)
            if held != wanted or told != wanted:
                raise Refuted(
                    f"{form.name} written {_shown(wanted)}: 0xC1 answers {_shown(told)}, 0xC0 reads {_shown(held)}",
                    expected=_shown(wanted), got=f"{_shown(told)}; {_shown(held)}", exchange=exchange,
                    key=f"{form.name} written",
                )  # fmt: skip

    def others(probe: Probe) -> None:
        rest = [number_of(f) for f in forms if f is not form]
        before = read_parameter(probe, number)
        was = {n: read_parameter(probe, n) for n in rest}
        exchange = probe.do(command, moderate(form, 0))
        now = {n: read_parameter(probe, n) for n in rest}
        probe.do(command, before)
        changed = [n for n in rest if now[n] != was[n]]
        if changed:
            raise Refuted(
                f"writing {form.name} changes parameter {changed[0]}", expected=_shown(was[changed[0]]),
                got=_shown(now[changed[0]]), exchange=exchange, key="parameter elsewhere",
            )  # fmt: skip

    def power(probe: Probe) -> None:
        before = read_parameter(probe, number)
        exchange = probe.do(command, moderate(form, 0))
        if read_parameter(probe, number) == before:
            raise Inconclusive(f"{form.name} does not change, so nothing can be lost")
        power_cycle(probe)
        after = read_parameter(probe, number)
        if after != before:
            raise Refuted(
                f"{form.name} written by 0xC1 survives the power", expected=_shown(before), got=_shown(after),
                exchange=exchange, key="parameter survives",
            )  # fmt: skip

    statement = f"{form.name} is held, answered and read as it was written."
    yield declare(
        dialect, Theme.READ_BACK, f"parameter/{form.name}/written", statement,
        "another value", written, command=command, aspect=Aspect.STATE, **needs,
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, f"parameter/{form.name}/others", f"Writing {form.name} changes no other parameter.",
        "another parameter that reads differently", others, command=command, aspect=Aspect.STATE, **needs,
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, f"parameter/{form.name}/power", f"{form.name} is as before when power comes on.",
        "the written value", power, command=command, aspect=Aspect.STATE, emulated=True, **needs,
    )  # fmt: skip


def _shown(values: dict[str, int]) -> str:
    return " ".join(f"{n} {v}" for n, v in values.items() if n != "parameter")


# --- positions --------------------------------------------------------------------------------------------------------


def position(probe: Probe) -> int:
    """Return the position over all turns, in hundredths of a degree."""
    return probe.read(Verb.READ_POSITION)


def move_by(probe: Probe, distance: int) -> None:
    """Move by hundredths of a degree at 60 rpm, and wait until the shaft stands."""
    probe.do("move_increment_limited", {"position": distance, "max_speed": MODERATE})
    moving.wait_standing(probe)


def _apart(one: int, other: int) -> int:
    """Return how far two angles within a turn are apart."""
    return min((one - other) % TURN, (other - one) % TURN)


def _positions(dialect: Dialect) -> Iterator[Claim]:
    setter, clear = dialect.by_name["set_position"], dialect.by_verb[Verb.CLEAR_TURNS]
    highest = setter.request_forms[0].layout.named["position"].high
    moved = moving.risks(dialect, Risk.SETTING)

    def beyond(probe: Probe) -> None:
        moving.ready_to_move(probe)
        moving.stand_still(probe)
        for start, distance in ((highest, 2_000), (-highest, -2_000)):
            exchange = probe.do(setter, {"position": start})
            move_by(probe, distance)
            now = position(probe)
            if abs(now - start - distance) > PLAY:
                raise Refuted(
                    f"from {start} a move by {distance} reads {now}", expected=f"{start + distance}", got=f"{now}",
                    exchange=exchange, key="position width",
                )  # fmt: skip

    def power(probe: Probe) -> None:
        moving.stand_still(probe)
        probe.do(setter, {"position": 1_234_500})
        power_cycle(probe)
        now, within = position(probe), probe.read(Verb.READ_SINGLE_TURN)
        if abs(now - within) > PLAY and abs(now - within + TURN) > PLAY:
            raise Refuted(f"after the power was cut the position reads {now}", expected=f"{within}, the angle within the turn",
                          got=f"{now}", key="set_position survives")  # fmt: skip

    def turns(probe: Probe) -> None:
        moving.stand_still(probe)
        probe.do(setter, {"position": 5 * TURN + 4_500})
        before = position(probe)
        exchange = probe.do(clear)
        now = position(probe)
        if abs(now) > TURN + PLAY:
            raise Refuted(f"after 0x93 the position reads {now}, before {before}", expected="less than a turn", got=f"{now}",
                          exchange=exchange, key="clear_turns")  # fmt: skip

    def counted(probe: Probe) -> None:
        moving.ready_to_move(probe)
        moving.stand_still(probe)
        probe.do(setter, {"position": 0})
        angle = probe.read(Verb.READ_SINGLE_TURN)
        for distance in (30_000, 30_000, -20_000, -80_000):
            start = position(probe)
            move_by(probe, distance)
            now, within = position(probe), probe.read(Verb.READ_SINGLE_TURN)
            if abs(now - start - distance) > PLAY:
                text = f"a move by {distance} changes the position from {start} to {now}"
                raise Refuted(text, expected=f"{start + distance}", got=f"{now}", key="position counts")
            if within >= TURN or _apart(within, (angle + now) % TURN) > PLAY:
                raise Refuted(
                    f"at {now} the angle within the turn reads {within}", expected=f"{(angle + now) % TURN}", got=f"{within}",
                    key="single turn",
                )  # fmt: skip

    yield declare(
        dialect, Theme.READ_BACK, "position/beyond-32-bits", "The position counts on beyond 32 bits.", "a position that wraps",
        beyond, command=dialect.by_verb[Verb.READ_POSITION], aspect=Aspect.STATE, errata=("lk-rs485-47",), risks=moved,
        settings=("position",),
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, "position/counts", "Position and angle within the turn follow the shaft over several turns.",
        "a position or angle that does not", counted, command=dialect.by_verb[Verb.READ_SINGLE_TURN], aspect=Aspect.STATE,
        risks=moved, settings=("position",), errata=("lk-rs485-45",),
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, "set_position/power", "A position that was set is gone with the power.", "the set position",
        power, command=setter, aspect=Aspect.STATE, emulated=True, risks={Risk.SETTING, Risk.MOTION}, settings=("position",),
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, "clear_turns/position", "0x93 drops the counted turns.", "a position of several turns", turns,
        command=clear, aspect=Aspect.STATE, at_best=Certainty.LIKELY, risks={Risk.SETTING, Risk.MOTION}, settings=("position",),
    )  # fmt: skip


# --- zero -------------------------------------------------------------------------------------------------------------


def encoder(probe: Probe) -> dict[str, int]:
    """Return what 0x90 reads."""
    return {n: int(v) for n, v in probe.reply(probe.ask(Verb.READ_ENCODER)).values.items()}


def _zero(dialect: Dialect) -> Iterator[Claim]:
    command = dialect.by_verb[Verb.SET_ZERO]
    needs: dict[str, Any] = {"risks": moving.risks(dialect) | command.all_risks, "settings": ("encoder_zero",)}
    play = 4

    def away(probe: Probe) -> dict[str, int]:
        """Move by a tenth of a turn, so that zero is not where it was."""
        moving.ready_to_move(probe)
        move_by(probe, 3_600)
        return encoder(probe)

    def offset(probe: Probe) -> dict[str, int]:
        """See to it that the offset is not 0, as it is on a new emulated drive, and move away from it."""
        before = away(probe)
        if not before["encoder_offset"] and probe.drive is not None:
            probe.do(command)
            power_cycle(probe)
            before = away(probe)
        return before

    def answer(probe: Probe) -> None:
        before = offset(probe)
        exchange = probe.do(command)
        told = int(probe.reply(exchange).values["encoder_zero"])
        if abs(told - before["encoder_raw"]) > play:
            raise Refuted(f"0x19 answers {told}", expected=f"the raw encoder, {before['encoder_raw']}", got=f"{told}",
                          exchange=exchange, key="zero not raw")  # fmt: skip

    def later(probe: Probe) -> None:
        before, angle = away(probe), probe.read(Verb.READ_SINGLE_TURN)
        exchange = probe.do(command)
        now, after = encoder(probe), probe.read(Verb.READ_SINGLE_TURN)
        if now["encoder_offset"] != before["encoder_offset"] or _apart(angle, after) > PLAY:
            raise Refuted(
                f"right after 0x19 the offset reads {now['encoder_offset']} and the angle {after}",
                expected=f"{before['encoder_offset']} and {angle} as before, until the next power-up",
                got=f"{now['encoder_offset']} and {after}", exchange=exchange, key="zero at once",
            )  # fmt: skip

    def power(probe: Probe) -> None:
        away(probe)
        told = int(probe.reply(probe.do(command)).values["encoder_zero"])
        power_cycle(probe)
        now, angle = encoder(probe), probe.read(Verb.READ_SINGLE_TURN)
        if abs(now["encoder_offset"] - told) > play or _apart(angle, 0) > PLAY:
            raise Refuted(
                f"after power-up the offset reads {now['encoder_offset']} and the angle {angle}", expected=f"{told} and 0",
                got=f"{now['encoder_offset']} and {angle}", key="zero lost",
            )  # fmt: skip

    for name, statement, refuted_by, check, emulated in (
        ("answer", "0x19 answers the raw encoder value.", "another value", answer, False),
        ("later", "The zero of 0x19 does not hold before the next power-up.", "a zero that moved", later, False),
        ("power", "The zero of 0x19 holds after power-up.", "the old zero", power, True),
    ):
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, check, command=command,
            aspect=Aspect.STATE, emulated=emulated, errata=("lk-rs485-39", "lk-rs485-40"), **needs,
        )  # fmt: skip


# --- encoder ----------------------------------------------------------------------------------------------------------


def _scale(probe: Probe) -> int:
    """Return how many counts a turn has, by how far the encoder goes for a sixteenth of a turn."""
    before = encoder(probe)["encoder_raw"]
    move_by(probe, TURN // 16)
    gone = (encoder(probe)["encoder_raw"] - before) * 16
    return min((1 << bits for bits in (14, 15, 16)), key=lambda counts: min(abs(gone - counts), abs(gone + 15 * counts)))


def _encoder(dialect: Dialect) -> Iterator[Claim]:
    command = dialect.by_verb[Verb.READ_ENCODER]
    zero = dialect.by_verb[Verb.SET_ZERO]

    def difference(probe: Probe) -> None:
        moving.ready_to_move(probe)
        scale = _scale(probe)
        move_by(probe, TURN // 8)
        probe.do(zero)
        power_cycle(probe)
        moving.ready_to_move(probe)
        move_by(probe, -TURN // 16)
        seen = encoder(probe)
        raw, offset, got = seen["encoder_raw"], seen["encoder_offset"], seen["encoder"]
        wanted = (raw - offset) % scale
        if got != wanted and got == (raw - offset) % (1 << 16):
            probe.meets(WIDE_DIFFERENCE)
            return
        if min((got - wanted) % scale, (wanted - got) % scale) > 1:
            raise Refuted(
                f"0x90: raw {raw}, offset {offset}, encoder {got}", expected=f"{wanted}, the difference", got=f"{got}",
                key="encoder difference",
            )  # fmt: skip

    def same(probe: Probe) -> None:
        moving.ready_to_move(probe)
        for distance in (4_000, 9_000):
            move_by(probe, distance)
            one = encoder(probe)["encoder"]
            other = probe.read(Verb.READ_STATE_2, "encoder")
            stays = probe.ask("move_increment_limited", {"position": 0, "max_speed": MODERATE})
            moved = int(probe.reply(stays).values["encoder"])
            if max(abs(one - other), abs(one - moved)) > 4:
                raise Refuted(
                    f"0x90 reads {one}, 0x9C {other}, the reply to a move {moved}", expected="one encoder",
                    got=f"{one}, {other}, {moved}", key="encoder coarse",
                )  # fmt: skip

    yield declare(
        dialect, Theme.READ_BACK, "read_encoder/difference", "The encoder of 0x90 is its raw value less its offset.",
        "another number", difference, command=command, aspect=Aspect.STATE, emulated=True,
        errata=("lk-rs485-37", "lk-rs485-38"), quirks=(WIDE_DIFFERENCE,), risks=moving.risks(dialect) | zero.all_risks,
        settings=("encoder_zero",),
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, "read_encoder/everywhere", "All replies that have the encoder have the same.",
        "two readings of one encoder that differ", same, command=command, aspect=Aspect.STATE, errata=("lk-rs485-19",),
        risks=moving.risks(dialect),
    )  # fmt: skip


# --- brake ------------------------------------------------------------------------------------------------------------


def _brake(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.BRAKE]

    def check(probe: Probe) -> None:
        for control in (0x00, 0x01, 0x00, 0x01):
            exchange = probe.do(command, {"brake_control": control})
            for _ in range(2):
                state = probe.read(command, "", {"brake_control": 0x10})
                if state != control:
                    raise Refuted(
                        f"brake control {control}: the state reads {state}", expected=f"{control}", got=f"{state}",
                        exchange=exchange, key="brake state",
                    )  # fmt: skip

    return declare(
        dialect, Theme.READ_BACK, "brake/state", "The brake's state reads as it was switched, however often.", "another state",
        check, command=command, aspect=Aspect.STATE, risks={Risk.TORQUE}, fields=("brake_control",),
    )  # fmt: skip
