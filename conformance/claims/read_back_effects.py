"""What is set is what the drive does: for settings that cannot be read, and besides for those that can (MKS).

    work mode     whether the bus can enable the motor          subdivision    how far 200 pulses go
    respond       which replies a move gets                     group          who hears the group's address
    home          speed and way of homing                       direction      which way a move goes
    enable level  whether the motor holds in a pulse mode       axis lock      whether it holds when a bus mode begins
    set zero      the encoder reads 0                           ports          what was written is read

Currents, keys, screen, interpolation and pulse delay show nowhere on the bus.

Rules kept here:
- Ways are compared with each other, never with clockwise: which way a real shaft turns is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance import journey, moving
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims import effects, ranges
from conformance.claims.answers import Taken, judged, plain_read
from conformance.claims.declare import declare
from conformance.claims.effects import BY_VERB, STEEP, Effect, shift
from conformance.claims.known_quirks import known
from conformance.moving import MS
from conformance.probe import Probe

HASTY = "hasty-writes-dropped"
#: Two settings with so long between them are in quick succession: real drives were seen to drop such.
SUCCESSION_NS = 20 * MS
_HOMING = (Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE, Risk.SETTING)
_SPEED_SHARE = 0.06


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about what settings do."""
    if not journey.is_mks(dialect):
        return
    verbs = dialect.by_verb
    for verb, effect in BY_VERB.items():
        if verb in verbs and effect.expected is not None:
            yield from _effects(dialect, verbs[verb], effect)
    for verb, make in _MORE.items():
        if verb in verbs:
            yield from make(dialect, verbs[verb])
    yield _succession(dialect)


def _effects(dialect: Dialect, command: Command, effect: Effect) -> Iterator[Claim]:
    expected = effect.expected
    assert expected is not None  # only those are asked for
    wanted = expected

    def check(probe: Probe) -> None:
        effect.ready(probe)
        for values in effect.values:
            form = command.request_forms[0]
            if not all(form.layout.named[n].allows(v) for n, v in values.items()):
                continue
            exchange = probe.do(command, ranges.plain(probe, command, form, **values))
            seen, should = effect.see(probe), wanted(dialect, values)
            if not effect.same(should, seen):
                text = " ".join(f"{n} {v}" for n, v in values.items())
                raise Refuted(
                    f"{command.name} {text}: {effect.words(seen)}", expected=effect.words(should), got=effect.words(seen),
                    exchange=exchange, key=f"{command.name} effect",
                )  # fmt: skip

    needs = ranges.needs(dialect, command, effect.values)
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", f"{command.name} does what it says.", "another effect, or none",
        check, command=command, aspect=Aspect.STATE, fields=tuple(command.request_forms[0].layout.named),
        risks=needs["risks"] | effect.risks(dialect), alone=needs["alone"] or effect.alone,
        settings=tuple(dict.fromkeys((*needs["settings"], *effect.settings(dialect)))),
        errata=_ERRATA.get(command.verb, ()),
    )  # fmt: skip


_ERRATA: Mapping[Verb, tuple[str, ...]] = {
    Verb.SET_RESPOND: ("mks-rs485-27", "mks-can-38"),
    Verb.SET_SUBDIVISION: ("mks-rs485-10", "mks-modbus-13", "mks-can-31"),
    Verb.SET_ZERO: (),
}


# --- home -------------------------------------------------------------------------------------------------------------


def _respond(dialect: Dialect, command: Command) -> Iterator[Claim]:
    """Make the claim that `respond` silences motion alone."""

    def check(probe: Probe) -> None:
        probe.do(command, {"respond": 0, "active": 0})
        for what, values in ((Verb.READ_STATUS, {}), (Verb.READ_SPEED, {}), (Verb.SET_SUBDIVISION, {"subdivision": 16})):
            exchanges = [probe.ask(what, values) for _ in range(3)]
            if all(e.silent for e in exchanges):
                name = probe.command(what).name
                raise Refuted(
                    f"with respond 0 {name} is not answered", expected="a reply", got="silence, three times",
                    exchange=exchanges[0], key="respond silences others",
                )  # fmt: skip
        probe.do(command, {"respond": 1, "active": 1})

    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/answers", "With respond 0 reads and settings are answered all the same.",
        "silence", check, command=command, aspect=Aspect.STATE, errata=_ERRATA[Verb.SET_RESPOND], fields=("respond",),
        risks={Risk.SETTING}, settings=("respond", "active", "subdivision"),
    )  # fmt: skip


def _group(dialect: Dialect, command: Command) -> Iterator[Claim]:
    """Make the claim that a drive in a group is still reached by its own address."""

    def check(probe: Probe) -> None:
        read = plain_read(dialect)
        for _ in range(3):
            probe.reply(probe.ask(read))
        exchange = probe.do(command, {"group_address": effects.GROUP})
        after = [probe.ask(read) for _ in range(3)]
        if all(e.silent for e in after):
            raise Refuted(
                f"in the group {effects.GROUP:#x} the drive does not answer at {probe.address}", expected="a reply",
                got="silence, three times", exchange=exchange, key="group replaces address",
            )  # fmt: skip

    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/own-address", "A drive in a group answers at its own address.", "silence",
        check, command=command, aspect=Aspect.STATE, fields=("group_address",), risks=command.all_risks, alone=True,
        settings=("group_address",),
    )  # fmt: skip


def _home(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def begun(probe: Probe, **values: int) -> tuple[effects.Homing, Any]:
        plain = ranges.plain(probe, command, command.request_forms[0], end_limit=0, home_speed=90)
        exchange = probe.do(command, plain | values)
        return effects.homing(probe), exchange

    def speed(probe: Probe) -> None:
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        for rpm in (90, 300):
            seen, exchange = begun(probe, home_speed=rpm)
            if abs(seen.rpm - rpm) > max(2.0, rpm * _SPEED_SHARE):
                raise Refuted(
                    f"set_home {rpm} rpm: {seen}", expected=f"homing at {rpm} rpm", got=str(seen), exchange=exchange,
                    key="home_speed effect",
                )  # fmt: skip

    def opposite(name: str) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
            (one, _), (other, exchange) = (begun(probe, **{name: value}) for value in (0, 1))
            if one.way == other.way:
                raise Refuted(
                    f"{name} 0 and 1 both begin homing the same way", expected="opposite ways", got=str(other),
                    exchange=exchange, key=f"{name} effect",
                )  # fmt: skip

        return check

    claims = (
        ("home_speed", "Homing turns at the speed that was set.", "another speed", speed),
        ("home_direction", "The other direction homes the other way.", "the same way", opposite("home_direction")),
        ("home_trigger", "With the other level the end stop counts as closed, and homing first leaves it.", "the same way",
         opposite("home_trigger")),
    )  # fmt: skip
    for name, statement, refuted_by, check in claims:
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, check, command=command,
            aspect=Aspect.STATE, fields=(name,), at_best=Certainty.CERTAIN if name != "home_trigger" else Certainty.LIKELY,
            risks=moving.risks(dialect, *_HOMING), settings=moving.settings(dialect, *command.request_forms[0].layout.named),
        )  # fmt: skip


# --- directions -------------------------------------------------------------------------------------------------------


def _direction(dialect: Dialect, command: Command) -> Iterator[Claim]:
    turns_bus = any("turns motion by the bus too" in note for note in command.notes)

    def check(probe: Probe) -> None:
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        move = {"direction": 0, "speed": 60, "acceleration": STEEP, "pulses": 800}
        gone = []
        for value in (0, 1):
            exchange = probe.do(command, {"motor_direction": value})
            gone.append(shift(probe, Verb.MOVE_RELATIVE_PULSES, move)[0])
        turned = gone[0] * gone[1] < 0
        if abs(gone[0]) < 100 or abs(gone[1]) < 100:
            raise Inconclusive(f"moves of 800 pulses turned the shaft by {gone[0]} and {gone[1]} counts")
        if turned != turns_bus:
            words = {True: "opposite ways", False: "the same way"}
            raise Refuted(
                f"set_direction 0 and 1 move the shaft {words[turned]}", expected=words[turns_bus], got=f"{gone} counts",
                exchange=exchange, key="set_direction effect",
            )  # fmt: skip

    statement = "turns" if turns_bus else "does not turn"
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", f"set_direction {statement} the way of motion by the bus.",
        "moves the other way" if not turns_bus else "moves the same way", check, command=command, aspect=Aspect.STATE,
        at_best=Certainty.LIKELY, fields=("motor_direction",), risks=moving.risks(dialect, Risk.SETTING),
        settings=moving.settings(dialect, "motor_direction"),
    )  # fmt: skip


# --- holding the shaft ------------------------------------------------------------------------------------------------


def pulse_mode(dialect: Dialect) -> int:
    """Return a work mode in which pulses move the motor, closed loop."""
    field = dialect.by_verb[Verb.SET_WORK_MODE].request_forms[0].layout.named["work_mode"]
    names = {v: n for v, n in field.choice_names.items() if n not in moving.bus_modes(dialect)}
    return next((v for v, n in names.items() if "clos" in n), next(iter(names)))


def _enable_level(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def check(probe: Probe) -> None:
        probe.do(Verb.SET_WORK_MODE, {"work_mode": pulse_mode(dialect)})
        seen = {}
        for value in (0, 1, 2):
            exchange = probe.do(command, {"enable_level": value})
            probe.wait(200 * MS)
            seen[value] = probe.read(Verb.READ_ENABLED)
        shown = ", ".join(f"{v} reads {s}" for v, s in seen.items())
        if seen[2] != 1:
            raise Refuted("enable_level 2 (always) reads disabled", expected="enabled 1", got=shown, exchange=exchange,
                          key="enable_level effect")  # fmt: skip
        if seen[0] == seen[1]:
            raise Refuted("enable_level 0 and 1 read alike", expected="one enabled, the other not", got=shown,
                          exchange=exchange, key="enable_level effect")  # fmt: skip

    setter = dialect.by_verb[Verb.SET_WORK_MODE]
    statement = "In a pulse mode the motor holds at the set level of En, or always."
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", statement,
        "a motor that holds at both levels, or lets go", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY,
        fields=("enable_level",), risks=command.all_risks | setter.all_risks, settings=("enable_level", "work_mode"),
        errata=("mks-rs485-23", "mks-modbus-10", "mks-can-27"),
    )  # fmt: skip


def _axis_lock(dialect: Dialect, command: Command) -> Iterator[Claim]:
    setter = dialect.by_verb[Verb.SET_WORK_MODE]

    def check(probe: Probe) -> None:
        bus = moving.choice(setter, "work_mode", moving.bus_modes(dialect)[-1])
        for value in (0, 1):
            exchange = probe.do(command, {"axis_lock": value})
            probe.do(setter, {"work_mode": pulse_mode(dialect)})
            probe.do(setter, {"work_mode": bus})
            seen = probe.read(Verb.READ_ENABLED)
            if seen != value:
                raise Refuted(
                    f"with axis_lock {value} a bus mode begins with enabled {seen}", expected=f"enabled {value}",
                    got=f"enabled {seen}", exchange=exchange, key="axis_lock effect",
                )  # fmt: skip

    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", "A bus mode begins with the shaft held or free as axis_lock says.",
        "a shaft that is held with 0, or free with 1", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY,
        fields=("axis_lock",), risks=command.all_risks | setter.all_risks, settings=("axis_lock", "work_mode"),
    )  # fmt: skip


# --- zero -------------------------------------------------------------------------------------------------------------


def _set_zero(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def moved(probe: Probe) -> None:
        moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
        move = {"direction": 0, "speed": 60, "acceleration": STEEP, "pulses": 800}
        if not -1000 < effects.counts(probe) < 1000:
            return
        shift(probe, Verb.MOVE_RELATIVE_PULSES, move)

    def check(probe: Probe) -> None:
        moved(probe)
        before = effects.counts(probe)
        exchange = probe.do(command)
        after = effects.counts(probe)
        carry = probe.reply(probe.ask(Verb.READ_ENCODER_CARRY)).values
        whole = carry.get("carry", 0) * COUNTS_PER_TURN + carry.get("encoder", 0)
        if abs(after) > _PLAY or abs(whole) > _PLAY:
            raise Refuted(
                f"after set_zero the encoder reads {after}, and {whole} by 30", expected="0, where it read " + str(before),
                got=f"{after}, {whole}", exchange=exchange, key="set_zero",
            )  # fmt: skip

    def stays(probe: Probe) -> None:
        moved(probe)
        probe.do(command)
        gone, _ = shift(probe, Verb.MOVE_ABSOLUTE_AXIS, {"speed": 60, "acceleration": STEEP, "position": 0})
        if abs(gone) > _PLAY:
            raise Refuted(f"a move to 0 right after set_zero turns the shaft by {gone} counts", expected="a shaft that stays",
                          got=f"{gone} counts", key="set_zero move")  # fmt: skip

    for name, statement, refuted_by, judge in (
        ("read", "Where the shaft is when zero is set, the encoder reads 0.", "another reading", check),
        ("move", "Zero is where the shaft is: a move to 0 stays there.", "a move", stays),
    ):
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, judge, command=command,
            aspect=Aspect.STATE, risks=moving.risks(dialect, Risk.SETTING), settings=moving.settings(dialect),
        )  # fmt: skip


#: Counts by which a shaft that is held plays.
_PLAY = 24


# --- ports ------------------------------------------------------------------------------------------------------------


def _ports(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def check(probe: Probe) -> None:
        for level in (0, 1):
            exchange = probe.do(command, {"alm_mask": 1, "pend_mask": 1, "alm": level, "pend": 1 - level})
            seen = probe.reply(probe.ask(Verb.READ_IO)).values
            wanted = {"alm": level, "pend": 1 - level}
            got = {n: seen.get(n) for n in wanted}
            if got != wanted:
                raise Refuted(f"ports written {wanted} read {got}", expected=str(wanted), got=str(got), exchange=exchange)
            probe.do(command, {"alm_mask": 2, "pend_mask": 2, "alm": 1 - level, "pend": level})
            kept = probe.reply(probe.ask(Verb.READ_IO)).values
            if {n: kept.get(n) for n in wanted} != wanted:
                raise Refuted("mask 2 does not keep a port", expected=str(wanted), got=str(dict(kept)), exchange=exchange)
        probe.do(command, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})

    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", "A written port reads as it was written, until it is given back.",
        "another level", check, command=command, aspect=Aspect.STATE, errata=("mks-can-41", "mks-can-42", "mks-can-25"),
        fields=tuple(command.request_forms[0].layout.named), risks=command.all_risks,
    )  # fmt: skip


def _remap(dialect: Dialect, command: Command) -> Iterator[Claim]:
    """Make the claim that remapped ports show a second switch, on drives that have one port for switches."""

    def check(probe: Probe) -> None:
        if probe.drive is None or getattr(probe.drive, "model", "").startswith("57"):
            raise Inconclusive("a 57 has a port for each switch, so that nothing shows whether they are remapped")
        moving.ready_to_move(probe)
        probe.drive.limit_switch("right", False)  # type: ignore[attr-defined]
        seen = []
        for value in (0, 1):
            exchange = probe.do(command, {"limit_remap": value})
            levels = []
            for pressed in (False, True):
                probe.drive.limit_switch("right", pressed)  # type: ignore[attr-defined]
                levels.append(probe.reply(probe.ask(Verb.READ_IO)).values.get("in_2"))
            seen.append(levels[0] != levels[1])
        if seen != [False, True]:
            raise Refuted(
                f"limit_remap 0 and 1: the right switch shows {seen}", expected="not with 0, and with 1", got=str(seen),
                exchange=exchange, key="limit_remap effect",
            )  # fmt: skip

    models = tuple(m for m in (command.models or dialect.models) if not m.startswith("57"))
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", "With the ports remapped the right switch shows at in_2.",
        "a switch that does not show", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY, emulated=True,
        models=models, fields=("limit_remap",), risks=command.all_risks | moving.risks(dialect),
        settings=moving.settings(dialect, "limit_remap"), errata=("mks-can-51", "mks-can-24"),
    )  # fmt: skip


# --- one after the other ----------------------------------------------------------------------------------------------


def _succession(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.SET_SUBDIVISION]
    quirks = known(dialect, HASTY)

    def check(probe: Probe) -> None:
        for value in (32, 16):
            built = probe.build(command, {"subdivision": value})
            probe.gate.wait(SUCCESSION_NS)
            exchange = probe.send(probe.item(built.frame), timeout_ns=300 * MS)
            if exchange.silent and quirks:
                probe.meets(HASTY)
                return
            exchange.command = command
            if judged(probe, exchange) is not Taken.DONE:
                raise Refuted(f"set_subdivision {value} right after another setting is refused", expected="success",
                              got=exchange.answers[0].data.hex(" ").upper(), exchange=exchange)  # fmt: skip

    return declare(
        dialect, Theme.READ_BACK, "settings/in-succession", "Two settings in quick succession are both taken.",
        "a setting that is not answered, or refused", check, section=command.section, at_best=Certainty.LIKELY, quirks=quirks,
        risks=command.all_risks, settings=("subdivision",), commands=(command.name,),
    )  # fmt: skip


_Make = Callable[[Dialect, Command], Iterator[Claim]]
#: What is claimed of settings that show in ways of their own.
_MORE: Mapping[Verb, _Make] = {
    Verb.SET_RESPOND: _respond,
    Verb.SET_GROUP_ADDRESS: _group,
    Verb.SET_HOME: _home,
    Verb.SET_DIRECTION: _direction,
    Verb.SET_ENABLE_LEVEL: _enable_level,
    Verb.SET_AXIS_LOCK: _axis_lock,
    Verb.SET_ZERO: _set_zero,
    Verb.WRITE_IO: _ports,
    Verb.SET_LIMIT_REMAP: _remap,
}
