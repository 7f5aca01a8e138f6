"""What is set is what the drive does: for settings that cannot be read, and besides for those that can (MKS).

    effect          a setting shows as it was set (`settings.setting_effects`): work mode, subdivision, group, enabled
    home            speed and direction of homing          enable level   whether the motor holds in a pulse mode
    axis lock       whether it holds when a bus mode begins       ports   what was written is read

What settings do to motion in full (direction, speeds, replies) stands in the theme motion. Currents, keys, screen,
interpolation and pulse delay show nowhere on the bus.

Rules kept here:
- Directions are compared with each other, never with clockwise: which way a real shaft turns is not judged.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.declare import Case, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.homing import SETS_HOME, set_home
from conformance.claims.motion.homing import fields as fields_of_homing
from conformance.claims.ranges import edges
from conformance.claims.settings import kept_effects, setting_effects
from conformance.claims.settings.kept_effects import Kept
from conformance.claims.settings.known_settings import Setting, every_setting, needs
from conformance.claims.settings.link_changes import NEW_ADDRESS_ANSWERS, another_rate, at_rate, change_address, other_address
from conformance.claims.settings.read_back import fields_of, of_read_back
from conformance.claims.settings.setting_effects import SettingEffect
from conformance.model import limits
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import MOVES, QUICK, SUBDIVISION
from conformance.talk import samples
from conformance.talk.probe import MS, Probe
from conformance.talk.restarts import restart
from conformance.talk.settings import LINK_EFFECTS


def _effects(dialect: Dialect) -> Iterator[Case]:
    for command in dialect.commands:
        effect = setting_effects.by_action(dialect, command)
        if effect is not None and effect.expected is not None and command.verb is not Verb.SET_RESPOND:
            facts = effect.needed(dialect, edges.needs(dialect, command, effect.values))
            yield Case(dialect, command, {"effect": effect}, facts | {"parameters": {}})


@of_read_back(each=_effects, refuted_by="another effect, or none", rests_on=(Doubt.EFFECT,), fields=fields_of)
def _effect(probe: Probe, command: Command, effect: SettingEffect) -> None:
    """{command} does what it says."""
    assert effect.expected is not None  # only those are asked for
    form = command.request_forms[0]
    effect.ready(probe)
    for values in effect.values:
        if not all(form.layout.named[n].allows(v) for n, v in values.items()):
            continue
        exchange = probe.do(command, edges.plain(probe, command, form, **values))
        seen, should = effect.see(probe), effect.expected(probe.dialect, values)
        text = f"{command.name} {' '.join(f'{n} {v}' for n, v in values.items())}: {effect.words(seen)}"
        effect.expect(probe, seen, should, text, exchange, f"{command.name} effect")


def _grouped(dialect: Dialect) -> Iterator[Case]:
    """Yield the setting of the group, with all that is set after it."""
    command, address = (dialect.by_verb.get(verb) for verb in (Verb.SET_GROUP_ADDRESS, Verb.SET_ADDRESS))
    effect = None if command is None else setting_effects.by_action(dialect, command)
    if command is not None and address is not None and effect is not None:
        others = [each for each in every_setting(dialect) if each.command.verb not in (command.verb, Verb.SET_ENABLE_LEVEL)]
        risks, names = needs(others)
        facts = effect.needed(dialect, edges.needs(dialect, command, effect.values), *risks, *address.all_risks)
        names += tuple(field.name for of in LINK_EFFECTS for _, field in dialect.effects(of))
        facts["settings"] = tuple(dict.fromkeys((*facts["settings"], *names)))
        yield Case(dialect, command, {"effect": effect, "others": others, "address": address}, facts | {"parameters": {}})


@of_read_back(
    each=_grouped,
    name="{command}/stays",
    refuted_by="another group, or none",
    fields=fields_of,
    at_best=Certainty.LIKELY,
    quirks=may_meet(NEW_ADDRESS_ANSWERS),
)
def _group_stays(probe: Probe, command: Command, effect: SettingEffect, others: list[Setting], address: Command) -> None:
    """A drive stays in its group while its other settings, its own address and its speed change."""
    assert effect.expected is not None  # a group is known by its address
    values = effect.values[0]
    effect.ready(probe)
    probe.do(command, values)
    own, away = probe.address, other_address(probe.dialect)
    other = away - (own == away)
    # What some modes refuse is set before the mode.
    for each in sorted(others, key=lambda each: each.command.verb is Verb.SET_WORK_MODE):
        probe.ask(each.command, each.values[0])
    exchange = change_address(probe, address, other)
    change_address(probe, address, own, at=other)
    with at_rate(probe, another_rate(probe)):
        pass
    effect.ready(probe)
    seen, should = effect.see(probe), effect.expected(probe.dialect, values)
    effect.expect(probe, seen, should, "a drive leaves its group when something else is set", exchange)


def _fields_with_hands(dialect: Dialect) -> Iterator[Case]:
    for command, row in kept_effects.rows(dialect):
        if row.hands:
            facts = row.effect.needed(dialect, edges.needs(dialect, command, [row.values]), *declared.risks(dialect))
            facts |= {"parameters": {"field": row.name}, "emulated": True}
            yield Case(dialect, command, {"row": row}, facts)


def _usual(field: Field, value: int) -> int:
    """Return the default of a field; where none is printed, of a choice another one, and else the value."""
    if field.default is not None:
        return int(field.default)
    return next((other for other in limits.listed(field) or () if other != value), value)


@of_read_back(each=_fields_with_hands, name="{command}/{row}-and-back", refuted_by="an effect that stays", fields=fields_of)
def _and_back(probe: Probe, command: Command, row: Kept) -> None:
    """With {row} set and set back the drive does what it did before."""
    plain = {name: _usual(command.request_forms[0].layout.named[name], value) for name, value in row.values.items()}
    seen = []
    for values in (plain, row.values, plain):
        motion.ready_to_move(probe)
        row.effect.ready(probe)
        exchange = probe.do(command, edges.plain(probe, command, command.request_forms[0], **values))
        seen.append(row.effect.see(probe))
    first, other, again = seen
    kept_effects.need_difference(probe, row, other, first)
    row.effect.expect(probe, again, first, f"{row.name} that is set back acts on", exchange)


# --- home -------------------------------------------------------------------------------------------------------------


def _home_trigger(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.SET_HOME)
    sent = frozenset[Risk]().union(*(c.all_risks for v in SETS_HOME if (c := dialect.by_verb.get(v)) is not None))
    if command is not None:
        facts = {
            "fields": ("home_trigger",),
            "risks": declared.risks(dialect, Risk.UNBOUNDED, Risk.TORQUE, *sent),
            "settings": declared.settings(dialect, *fields_of_homing(dialect)),
        }
        yield Case(dialect, command, {}, facts)


#: So far from a closed end stop a shaft is still on its way when its speed has been looked at (counts).
_LONG_BACK = 0x8000


@of_read_back(each=_home_trigger, name="{command}/home_trigger", refuted_by="the same way", at_best=Certainty.LIKELY)
def _other_trigger(probe: Probe) -> None:
    """With the other level the end stop counts as closed, and homing first leaves it."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    seen = []
    for level in (0, 1):
        exchange = set_home(probe, return_angle=_LONG_BACK, home_speed=90, home_trigger=level)
        seen.append(setting_effects.homing(probe))
    one, other = seen
    probe.expect(
        str(other),
        holds=one.way != other.way,
        expected="opposite ways",
        refutes="home_trigger 0 and 1 both begin homing the same way",
        exchange=exchange,
        key="home_trigger effect",
    )


# --- holding the shaft ------------------------------------------------------------------------------------------------


def _pulse_mode(dialect: Dialect) -> int:
    """Return a work mode in which pulses move the motor, closed loop."""
    field = dialect.by_verb[Verb.SET_WORK_MODE].request_forms[0].layout.named["work_mode"]
    names = {v: n for v, n in field.choice_names.items() if n not in declared.bus_modes(dialect)}
    return next((v for v, n in names.items() if "clos" in n), next(iter(names)))


def _with_work_mode(verb: Verb, *more: Verb) -> Any:
    """Return the case of a setting that shows when the work mode changes. `more`: what else is sent."""

    def cases(dialect: Dialect) -> Iterator[Case]:
        command = dialect.by_verb.get(verb)
        if command is not None:
            (name,) = command.request_forms[0].layout.named
            sent = (Verb.SET_WORK_MODE, *more)
            risks = command.all_risks.union(*(dialect.by_verb[each].all_risks for each in sent))
            facts = {"fields": (name,), "settings": (name, "work_mode"), "risks": risks}
            yield Case(dialect, command, {}, facts)

    return cases


@of_read_back(
    each=_with_work_mode(Verb.SET_ENABLE_LEVEL),
    name="{command}/effect",
    refuted_by="a motor that holds at both levels, or lets go",
    at_best=Certainty.LIKELY,
    rests_on=(Doubt.MEANING,),
)
def _enable_level(probe: Probe, command: Command) -> None:
    """In a pulse mode the motor holds at the set level of En, or always."""
    probe.do(Verb.SET_WORK_MODE, {"work_mode": _pulse_mode(probe.dialect)})
    seen = {}
    for value in (0, 1, 2):
        exchange = probe.do(command, {"enable_level": value})
        probe.wait(200 * MS)
        seen[value] = probe.read(Verb.READ_ENABLED)
    shown = ", ".join(f"{v} reads {s}" for v, s in seen.items())
    for holds, expected, refutes in (
        (seen[2] == 1, "enabled 1", "enable_level 2 (always) reads disabled"),
        (seen[0] != seen[1], "one enabled, the other not", "enable_level 0 and 1 read alike"),
    ):
        probe.expect(shown, holds=holds, expected=expected, refutes=refutes, exchange=exchange, key="enable_level effect")


@of_read_back(
    each=_with_work_mode(Verb.SET_ENABLE_LEVEL),
    name="{command}/pin",
    refuted_by="a motor that holds at another level",
    at_best=Certainty.LIKELY,
    emulated=True,
)
def _enable_pin(probe: Probe, command: Command) -> None:
    """In a pulse mode the motor holds at the level of En that was set (0, 1), or at both (2)."""
    probe.do(Verb.SET_WORK_MODE, {"work_mode": _pulse_mode(probe.dialect)})
    for value in (0, 1, 2):
        exchange = probe.do(command, {"enable_level": value})
        for level in (1, 0):
            bench.enable_pin(probe, level)
            probe.wait(200 * MS)
            text = f"enable_level {value} at the level {level} of En"
            wanted = int(value in (2, level))
            probe.expect(probe.read(Verb.READ_ENABLED), equal=wanted, refutes=text, exchange=exchange, key="enable_level pin")
            bench.expect_hold(probe, bool(wanted), f"with {text}")


@of_read_back(
    each=_with_work_mode(Verb.SET_AXIS_LOCK, Verb.ENABLE, Verb.RESTART),
    name="{command}/effect",
    refuted_by="a shaft that is held with 0, or free with 1",
    at_best=Certainty.LIKELY,
)
def _axis_lock(probe: Probe, command: Command) -> None:
    """A bus mode begins with the shaft held or free as axis_lock says: when it is set, and after a restart."""
    for value in (0, 1):
        exchange = probe.do(command, {"axis_lock": value})
        probe.do(Verb.SET_WORK_MODE, {"work_mode": _pulse_mode(probe.dialect)})
        motion.set_mode(probe, declared.bus_modes(probe.dialect)[-1])
        for begin_again, when in ((None, "when it is set"), (restart, "after a restart")):
            if begin_again is not None:
                # A motor that is as before has not begun anew.
                motion.switch(probe, not value)
                begin_again(probe)
            seen = probe.read(Verb.READ_ENABLED)
            text = f"with axis_lock {value} a bus mode begins with enabled {seen} {when}"
            probe.expect(seen, equal=value, refutes=text, exchange=exchange, key="axis_lock effect")


# --- ports ------------------------------------------------------------------------------------------------------------


@of_read_back(
    each=commands(Verb.WRITE_IO),
    name="{command}/effect",
    refuted_by="another level",
    rests_on=(Doubt.EFFECT,),
    fields=fields_of,
    risks=lambda case: case.command.all_risks,
)
def _ports(probe: Probe, command: Command) -> None:
    """A written port reads as it was written, until it is given back."""
    for level in (0, 1):
        wanted = {"alm": level, "pend": 1 - level}
        exchange = probe.do(command, {"alm_mask": 1, "pend_mask": 1, **wanted})
        got = _levels(probe, *wanted)
        probe.expect(got, equal=wanted, refutes=f"ports written {wanted} read {got}", exchange=exchange)
        probe.do(command, {"alm_mask": 2, "pend_mask": 2, "alm": 1 - level, "pend": level})
        probe.expect(_levels(probe, *wanted), equal=wanted, refutes="mask 2 does not keep a port", exchange=exchange)
    probe.do(command, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})


@of_read_back(
    each=commands(Verb.WRITE_IO),
    name="{command}/gives-back",
    refuted_by="a port that stays as it was written",
    at_best=Certainty.LIKELY,
    risks=lambda case: case.command.all_risks | case.dialect.by_verb[Verb.SET_PULSE_DIVISION].all_risks,
    settings=("division_level", "division_period"),
)
def _gives_back(probe: Probe, command: Command) -> None:
    """With mask 0 the ports tell again that there is no alarm and that the shaft is in place."""
    probe.do(Verb.SET_PULSE_DIVISION, {"division_level": 0, "division_period": 0})
    for level in (0, 1):
        probe.do(command, {"alm_mask": 1, "pend_mask": 1, "alm": 0, "pend": 0})
        if set(_levels(probe, "alm", "pend").values()) != {0}:
            raise Inconclusive("the ports do not read as they were written")
        exchange = probe.do(command, {"alm_mask": 0, "pend_mask": 0, "alm": level, "pend": level})
        wanted = {"alm": 1, "pend": 1}
        text = "ports that were given back do not tell what they tell at rest"
        probe.expect(_levels(probe, *wanted), equal=wanted, refutes=text, exchange=exchange)


@of_read_back(
    each=commands(Verb.WRITE_IO),
    name="{command}/each-port",
    refuted_by="a port that its mask does not name",
    at_best=Certainty.LIKELY,
    risks=lambda case: case.command.all_risks,
)
def _each_port(probe: Probe, command: Command) -> None:
    """A mask writes its own port and leaves the other one."""
    for port, other in (("alm", "pend"), ("pend", "alm")):
        for level in (0, 1):
            probe.do(command, {"alm_mask": 1, "pend_mask": 1, "alm": 1 - level, "pend": 1 - level})
            exchange = probe.do(command, {f"{port}_mask": 1, f"{other}_mask": 2, port: level, other: level})
            wanted = {port: level, other: 1 - level}
            text = f"a write of {port} alone does not leave {other} as it was"
            probe.expect(_levels(probe, *wanted), equal=wanted, refutes=text, exchange=exchange)
    probe.do(command, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})


def _stays_written(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.WRITE_IO)(dialect) if declared.can_move(dialect) else ():
        assert case.command is not None  # cases of commands
        deeds = [dialect.by_verb[verb] for verb in _ALTERING if verb in dialect.by_verb]
        every = (case.command, *deeds, *dialect.motions(MotionKind.RUN, *MOVES))
        risks = frozenset[Risk]().union(*(command.all_risks for command in every))
        facts = {
            "risks": declared.risks(dialect, *risks - {Risk.UNKNOWN}),
            "settings": declared.settings(dialect, "stall_tolerance"),
        }
        yield Case(dialect, case.command, {"deeds": deeds}, facts)


#: What is done to a drive whose ports were written, beside motions.
_ALTERING = (Verb.EMERGENCY_STOP, Verb.SET_ZERO, Verb.ENABLE, Verb.SET_STALL_TOLERANCE, Verb.RELEASE_PROTECTION)


@of_read_back(
    each=_stays_written, name="{command}/stays", refuted_by="a port that another command writes", at_best=Certainty.LIKELY
)
def _stays(probe: Probe, command: Command, deeds: list[Command]) -> None:
    """A written port stays as it was written while a motor moves, stops, is switched, or is set."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    moves = probe.dialect.motions(MotionKind.RUN, *MOVES)
    for level in (0, 1):
        wanted = {"alm": level, "pend": level}
        probe.do(command, {"alm_mask": 1, "pend_mask": 1, **wanted})
        for each in (*moves, *deeds):
            if each in moves:
                if declared.of(each).kind is MotionKind.RUN:
                    motion.run_at(probe, 60)
                    _expect_levels(probe, wanted, each, "while the shaft turns")
                    motion.stop(probe)
                    motion.wait_standing(probe)
                else:
                    arriving.follow(probe, each, 10, acceleration=QUICK)
            elif each.verb is Verb.ENABLE:
                motion.switch(probe, False)
                _expect_levels(probe, wanted, each, "while the motor is off")
                motion.switch(probe, True)
            else:
                probe.do(each, samples.sample(probe.dialect, each))
            _expect_levels(probe, wanted, each, "then")
    probe.do(command, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})


def _expect_levels(probe: Probe, wanted: dict[str, int], after: Command, when: str) -> None:
    text = f"ports that were written read otherwise after {after.name}, {when}"
    probe.expect(_levels(probe, *wanted), equal=wanted, refutes=text)


def _levels(probe: Probe, *ports: str) -> dict[str, int | None]:
    values = probe.reply(probe.ask(Verb.READ_IO)).values
    return {port: values.get(port) for port in ports}


def _of_one_port(dialect: Dialect) -> Iterator[Case]:
    """Yield the remapping of ports on drives that have one port for switches."""
    command = dialect.by_verb.get(Verb.SET_LIMIT_REMAP)
    if command is not None:
        models = tuple(m for m in (command.models or dialect.models) if not m.startswith("57"))
        facts = {
            "models": models,
            "risks": command.all_risks | declared.risks(dialect),
            "settings": declared.settings(dialect, "limit_remap"),
        }
        yield Case(dialect, command, {}, facts)


@of_read_back(
    each=_of_one_port,
    name="{command}/effect",
    refuted_by="a switch that does not show",
    at_best=Certainty.LIKELY,
    rests_on=(Doubt.EFFECT,),
    emulated=True,
    fields=("limit_remap",),
)
def _remap(probe: Probe, command: Command) -> None:
    """With the ports remapped the right switch shows at in_2."""
    if probe.drive is None or getattr(probe.drive, "model", "").startswith("57"):
        raise Inconclusive("a 57 has a port for each switch, so that nothing shows whether they are remapped")
    motion.ready_to_move(probe)
    seen = []
    for value in (0, 1):
        exchange = probe.do(command, {"limit_remap": value})
        levels = []
        for pressed in (False, True):
            probe.drive.limit_switch("right", pressed)  # type: ignore[attr-defined]
            levels.append(_levels(probe, "in_2"))
        seen.append(levels[0] != levels[1])
    probe.expect(
        str(seen),
        holds=seen == [False, True],
        expected="not with 0, and with 1",
        refutes=f"limit_remap 0 and 1: the right switch shows {seen}",
        exchange=exchange,
        key="limit_remap effect",
    )
