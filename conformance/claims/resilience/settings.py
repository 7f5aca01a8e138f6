"""Settings and switches in every condition: what is set at rest is set while the shaft turns, is off, was stopped or protected.

A covering array tells what is tried: every setting in every condition, and each with every kind of value and of address in
some of them. What is stored is read at once and again behind all the others; where no read shows it, a move and a homing do.

Rules kept here:
- While the shaft turns nothing is set that may change how it turns.
- What is refused leaves what was set before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Form, Risk, Verb
from conformance.claim import Theme
from conformance.claims import conditions
from conformance.claims.addressing.ways import group_of
from conformance.claims.conditions import AT_REST, Condition
from conformance.claims.control_reads import is_exception, received_text
from conformance.claims.declare import Case, claim
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import expect_goes
from conformance.claims.motion.told import expect_states, states
from conformance.claims.settings import setting_effects
from conformance.claims.settings.known_settings import ReadableSetting, Setting, every_setting, needs
from conformance.claims.settings.setting_effects import STEEP, by_action
from conformance.model import covering, lk_parameters
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import anew
from conformance.motion.declared import MOVES, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk.acceptance import Acceptance, can_refuse, without_repeats
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe, Until

#: What is sent: either of two sets of values, or from the third on those that the manual forbids; and to whom.
_ONE, _OTHER = 0, 1
_OWN, _ALL, _GROUP = "own", "all", "group"
#: What may change how a turning shaft turns, or whether it is told.
_AT_REST_ALONE = frozenset(
    {Verb.SET_WORK_MODE, Verb.SET_RESPOND, Verb.SET_DIRECTION, Verb.SET_ENABLE_LEVEL, Verb.SET_CURRENT, Verb.SET_HOME}
)
#: How long a setting that is not answered is given, and a move of `setting_effects.PULSES` at 16 subdivisions and more.
_SILENT_NS, _MOVE_NS = 60 * MS, 450 * MS


@dataclass(frozen=True)
class _Row:
    """A setting, which of its values is sent, and to whom."""

    setting: Setting
    value: int
    to: str

    @property
    def values(self) -> Mapping[str, int]:
        every: tuple[Mapping[str, int], ...] = (*self.setting.values, *self.setting.wrong)
        return every[self.value]

    @property
    def is_wrong(self) -> bool:
        return self.value > _OTHER


# --- what is tried ------------------------------------------------------------------------------------------------------


def _conditions(dialect: Dialect) -> list[Condition]:
    """Return the conditions that a drive of a dialect can be in, but for those that change it for good."""
    return [AT_REST, *(each for each in conditions.every(dialect) if not each.by_name)] if declared.can_move(dialect) else []


def _rows(dialect: Dialect) -> Iterator[tuple[Condition, list[_Row]]]:
    every = {each.name: each for each in _conditions(dialect)}
    chosen = {each.name: each for each in every_setting(dialect)}

    def is_allowed(condition: str, setting: str) -> bool:
        own = every[condition].settings
        command = chosen[setting].command
        if any(name in own for name in chosen[setting].names) or (command.modes and "work_mode" in own):
            return False
        return every[condition].stands or command.verb not in _AT_REST_ALONE

    def can_be_wrong(setting: str, value: int, to: str) -> bool:
        return value <= _OTHER or (to == _OWN and value < 2 + wrong[setting])

    def shows(setting: str, to: str) -> bool:
        return to == _OWN or isinstance(chosen[setting], ReadableSetting) or _effect(dialect, chosen[setting]) is not None

    def is_heard(condition: str, to: str) -> bool:
        return to != _GROUP or condition == "grouped"

    places = {name: place for place, name in enumerate(chosen)}
    wrong = {name: len(each.wrong) for name, each in chosen.items()}
    factors = {
        "condition": list(every),
        "setting": list(chosen),
        "value": range(2 + max(wrong.values(), default=0)),
        "to": (_OWN, *((_ALL,) if dialect.broadcast is not None else ()), *((_GROUP,) if "grouped" in every else ())),
    }
    array = covering.rows(factors, is_allowed, can_be_wrong, shows, is_heard) if every and chosen else ()
    for number, condition in enumerate(every.values()):
        of_condition = [row for row in array if row["condition"] == condition.name]
        # In the manual's order and against it, so that what changes another setting shows. Some settings need a work mode.
        way = (-1) ** number
        of_condition.sort(
            key=lambda row: (
                chosen[row["setting"]].command.verb is Verb.SET_WORK_MODE,
                way * places[row["setting"]],
                # What is sent to all drives is not overwritten.
                row["to"] != _OWN,
            )
        )
        found = [_Row(chosen[row["setting"]], row["value"], row["to"]) for row in of_condition]
        # A value that is refused leaves one that is taken in this condition.
        alone = [row for row in found if row.is_wrong and not any(o.setting is row.setting and not o.is_wrong for o in found)]
        taken = {row.setting.name: _Row(row.setting, _ONE, _OWN) for row in alone}
        yield condition, [each for row in found for each in (taken.pop(row.setting.name, None), row) if each is not None]


def _effect(dialect: Dialect, setting: Setting) -> setting_effects.SettingEffect | None:
    return by_action(dialect, setting.command)


def _settings_cases(dialect: Dialect) -> Iterator[Case]:
    for condition, rows in _rows(dialect):
        risks, names = needs(row.setting for row in rows)
        facts = condition.facts(dialect, *risks, settings=names)
        facts |= {
            "alone": dialect.broadcast is not None,
            "commands": tuple(dict.fromkeys(r.setting.command.name for r in rows)),
        }
        yield Case(dialect, given={"condition": condition, "when": condition.when, "rows": rows}, facts=facts)


_in_conditions = partial(
    claim,
    Theme.RESILIENCE,
    section=lambda case: case.dialect.by_verb[Verb.RUN_SPEED].section,
    at_best=Certainty.LIKELY,
    parameters={},
)

# --- settings -----------------------------------------------------------------------------------------------------------


@_in_conditions(
    each=_settings_cases,
    name="settings/{condition}",
    refuted_by="a refusal, silence, or another stored value",
    quirks=may_meet(lk_parameters.OTHER_FIRMWARE),
)
def _settings(probe: Probe, condition: Condition, rows: list[_Row]) -> None:
    """Every setting is taken {when} and holds; a forbidden value is refused and changes nothing."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    held: dict[str, Mapping[str, int]] = {}
    homing = None
    for row in rows:
        if isinstance(row.setting, ReadableSetting):
            held[row.setting.name] = row.setting.read(probe)
        elif row.is_wrong and row.setting.command.verb is Verb.SET_HOME and homing is None:
            # Which way homing goes is told by another one alone; what is set then shows beside what was set before it.
            _home_by_a_switch(probe)
            probe.do(row.setting.command, row.setting.values[_ONE])
            homing = setting_effects.homing(probe)
            probe.do(row.setting.command, row.setting.values[_OTHER])
    motion.ready_to_move(probe, condition.mode)
    before = {} if condition.stands else states(probe)
    condition.enter(probe)
    turning = motion.speed(probe) if condition.steady else None
    for row in rows:
        _set(probe, row, condition.when, held)
        if row.setting.command.verb is Verb.SET_HOME and row.value == _OTHER:
            homing = None
    if turning is not None:
        text, within = f"settings change the speed of the shaft {condition.when}", 6 + abs(turning.value) * _SPEED_SHARE
        probe.expect(motion.speed(probe).value, near=turning.value, within=within, unit="rpm", refutes=text)
    condition.leave(probe)
    motion.wait_standing(probe)
    if before:
        expect_states(probe, before, f"behind settings {condition.when}")
    for row in rows:
        if isinstance(row.setting, ReadableSetting):
            _expect_stored(probe, row.setting, held, f"{condition.when}, and other settings behind it")
    expect_effects(probe, [row.setting for row in rows], held, condition.when, homing)


def _home_by_a_switch(probe: Probe) -> None:
    """Let homing go by the switch at its own port: a closed one turns it round, where nothing else leads it elsewhere."""
    for verb, name in ((Verb.SET_NO_LIMIT_HOME, "home_mode"), (Verb.SET_LIMIT_REMAP, "limit_remap")):
        if verb in probe.dialect.by_verb:
            probe.do(verb, {name: 0})


def _set(probe: Probe, row: _Row, when: str, held: dict[str, Mapping[str, int]]) -> None:
    """Send a setting, judge its reply, and note the value that must hold from then on."""
    setting, command = row.setting, row.setting.command
    values = row.values
    if isinstance(setting, ReadableSetting) and not row.is_wrong:
        values = setting.other(held[setting.name], row.value)
    if row.to != _OWN:
        _told_all(probe, command, values, row.to, setting.form)
    else:
        _expect_reply(probe, setting, values, Acceptance.REFUSED if row.is_wrong else Acceptance.DONE, when)
    if not row.is_wrong:
        held[setting.name] = values
    if isinstance(setting, ReadableSetting):
        _expect_stored(probe, setting, held, when)


def _told_all(probe: Probe, command: Command, values: Mapping[str, int], to: str, form: Form | None = None) -> Exchange:
    """Send something to all drives, or to a group; that is not answered."""
    address = probe.dialect.broadcast if to == _ALL else group_of(probe.dialect, probe.address)
    return probe.send(probe.build(command, values, address=address, form=form).item(), timeout_ns=_SILENT_NS)


def _expect_reply(probe: Probe, setting: Setting, values: Mapping[str, int], wanted: Acceptance, when: str) -> None:
    command = setting.command
    exchange = _asked(probe, command, values, when, setting=setting)
    text = f"{setting.name} {_text(values)} is not {wanted.value} {when}"
    if can_refuse(command):
        answer = probe.reply(exchange)
        refused = probe.refused(exchange) or is_exception(answer)
        holds = refused is (wanted is Acceptance.REFUSED)
        probe.expect(received_text(exchange), holds=holds, expected=wanted.value, refutes=text, exchange=exchange)
    else:
        answered = {name: value for name, value in probe.reply(exchange).values.items() if name in values}
        probe.expect(answered, equal=dict(values), refutes=text, exchange=exchange)


def _asked(probe: Probe, command: Command, values: Mapping[str, int], when: str, setting: Setting | None = None) -> Exchange:
    """Ask for something that must be answered; one reply may be lost, or damaged so that it is no frame."""
    form = setting.form if setting is not None else None
    for _ in range(2):
        exchange = probe.ask(command, values, form=form, quiet_ns=0)
        if exchange.answers:
            break
    text = f"{command.name} is not answered {when}"
    probe.expect(received_text(exchange), holds=bool(exchange.answers), expected="a reply", refutes=text, exchange=exchange)
    return exchange


def _expect_stored(probe: Probe, setting: ReadableSetting, held: Mapping[str, Mapping[str, int]], when: str) -> None:
    wanted = held[setting.name]
    got = setting.read(probe)
    text = f"{setting.name} set {when} does not read as it was set"
    probe.expect({n: got[n] for n in got if n in wanted}, equal={n: wanted[n] for n in got if n in wanted}, refutes=text)


def _text(values: Mapping[str, int]) -> str:
    return " ".join(f"{name} {value}" for name, value in values.items() if name != "parameter")


# --- settings that leave motion as it is ----------------------------------------------------------------------------------

#: What motion goes by, or whether it is told.
_OF_MOTION = _AT_REST_ALONE | {Verb.SET_SUBDIVISION, Verb.SET_GROUP_ADDRESS, Verb.SET_STALL_TOLERANCE}
#: A speed near the highest one, its ramp and how long it is kept; the turns of a move and its speed, and degrees of others.
_NEARLY, _STEEPEST, _KEPT_NS, _MOVED_TURNS, _MOVED_RPM, _SHORTLY = 2900, 255, 100 * MS, 4, 1700, 90


def _of_no_motion(dialect: Dialect) -> Iterator[Case]:
    if dialect.ramp is not None and declared.can_move(dialect):
        every = every_setting(dialect)
        chosen = [each for each in every if each.command.verb not in _OF_MOTION and not each.command.modes]
        risks, names = needs(chosen)
        for each in dialect.motions(*RUNS_AND_MOVES):
            risks |= each.all_risks
        facts = {
            "risks": declared.risks(dialect, *risks),
            "settings": tuple(dict.fromkeys(declared.settings(dialect, *names))),
            "commands": tuple(dict.fromkeys(each.command.name for each in chosen)),
        }
        if chosen:
            yield Case(dialect, given={"chosen": chosen}, facts=facts)


@_in_conditions(each=_of_no_motion, name="settings/leave-motion", refuted_by="another speed or way, or a refusal")
def _leave_motion(probe: Probe, chosen: list[Setting]) -> None:
    """Settings that say nothing of motion change no run and no move, at any of their values."""
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    for which, way in ((_ONE, 1), (_OTHER, -1)):
        motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
        for each in chosen:
            probe.do(each.command, each.values[which])
        exchange = motion.run_at(probe, way * _NEARLY, _STEEPEST)
        probe.wait(int(ramp.ramp_ns(0, _NEARLY, _STEEPEST)) + _KEPT_NS)
        seen = motion.speed(probe)
        motion.stop(probe, _STEEPEST)
        motion.wait_standing(probe)
        text = "a run turns the shaft at another speed with other settings that say nothing of it"
        within = _NEARLY * _SPEED_SHARE
        probe.expect(abs(seen.value), near=_NEARLY, within=within, unit="rpm", refutes=text, exchange=exchange)
        moved = arriving.follow(probe, move, -way * _MOVED_TURNS * 360, rpm=_MOVED_RPM, acceleration=_STEEPEST)
        text = "a move goes elsewhere with other settings that say nothing of it"
        probe.expect(moved.degrees, near=moved.asked, unit="degrees", refutes=text, exchange=moved.exchange)
        for other in (each for each in probe.dialect.motions(*MOVES) if each is not move):
            expect_goes(
                probe,
                other,
                way * _SHORTLY,
                "with other settings that say nothing of it",
                rpm=_MOVED_RPM,
                acceleration=_STEEPEST,
            )


# --- what is seen of settings that no read shows ------------------------------------------------------------------------


def expect_effects(
    probe: Probe,
    chosen: list[Setting],
    held: Mapping[str, Mapping[str, int]],
    when: str,
    before: setting_effects.Homing | None = None,
) -> None:
    """Refute unless the drive does what it was set to. `before`: how it homed before a setting of that was refused."""
    unread = {each.command.verb: each for each in chosen if not isinstance(each, ReadableSetting) and each.name in held}
    shown = {verb: held[each.name] for verb, each in unread.items() if _effect(probe.dialect, each) is not None}
    if Verb.SET_WORK_MODE in shown:
        effect = setting_effects.BY_VERB[Verb.SET_WORK_MODE]
        assert effect.expected is not None  # a work mode decides whether the bus moves the motor
        _expect_shown(
            probe, effect.see(probe), effect.expected(probe.dialect, shown[Verb.SET_WORK_MODE]), "the work mode", when
        )
        motion.set_mode(probe, declared.bus_modes(probe.dialect)[-1])
    motion.ready_to_move(probe)
    if Verb.SET_SUBDIVISION in shown or Verb.SET_RESPOND in shown:
        _expect_move(probe, shown, when)
    for each in {
        each.name: each for each in chosen if each.command.verb is Verb.SET_SUBDIVISION and each.name in held
    }.values():
        _expect_run(probe, held[each.name]["subdivision"], when)
    if Verb.SET_HOME in shown:
        # Its speed goes by the subdivision too.
        motion.ready_to_move(probe, subdivision=SUBDIVISION)
        if before is not None:
            _home_by_a_switch(probe)
        seen, wanted = setting_effects.homing(probe), shown[Verb.SET_HOME]["home_speed"]
        text = f"set_home set {when} is another homing"
        probe.expect(seen.rpm, near=wanted, within=max(2.0, wanted * _SPEED_SHARE), unit="rpm", refutes=text)
        if before is not None:
            probe.expect(seen.way, equal=before.way, refutes=f"a refused set_home {when} turns homing round")


#: Speeds that are one; a speed that a coarse subdivision reaches too, and when it is reached.
_SPEED_SHARE, _RUN_RPM, _RUN_NS = 0.06, 60, 100 * MS


def _expect_run(probe: Probe, subdivision: int, when: str) -> None:
    """Refute a run whose shaft has another speed than the sent one at this subdivision."""
    law, run = probe.dialect.subdivision, probe.command(Verb.RUN_SPEED)
    assert law is not None  # there is a subdivision to set
    values = declared.values_of(probe.dialect, run, rpm=_RUN_RPM, acceleration=STEEP, subdivision=subdivision)
    exchange, seen = _ran(probe, run, values)
    sent = values[declared.of(run).speed]
    wanted = sent if subdivision in law.plain else sent * law.counted_at / subdivision
    text = f"a run has another speed than its subdivision says, which was set {when}"
    probe.expect(abs(seen.value), near=wanted, within=_SPEED_SHARE * wanted + 2, unit="rpm", refutes=text, exchange=exchange)


@anew
def _ran(probe: Probe, run: Command, values: Mapping[str, int]) -> tuple[Exchange, motion.Sample]:
    """Run from rest to rest; return what was said, and how fast the shaft was."""
    # `respond` may silence it.
    exchange = probe.ask(run, values, until=Until.TIMEOUT, timeout_ns=_RUN_NS)
    seen = motion.speed(probe)
    probe.ask(Verb.STOP_SPEED, {"acceleration": STEEP}, until=Until.TIMEOUT, timeout_ns=_SILENT_NS)
    motion.wait_standing(probe)
    return exchange, seen


def _expect_move(probe: Probe, shown: Mapping[Verb, Mapping[str, int]], when: str) -> None:
    """Refute unless a move goes as far as the subdivision says, and is answered as `respond` says."""
    command, pulses = probe.command(Verb.MOVE_RELATIVE_PULSES), setting_effects.PULSES
    values = {"direction": 0, "speed": 18, "acceleration": STEEP, "pulses": pulses}
    respond = shown.get(Verb.SET_RESPOND, {"respond": 1, "active": 1})
    # Where its end is told, no more is waited for.
    told = respond["respond"] and respond["active"] and declared.of(command).tells_end
    exchange, went = _moved(probe, command, values, Until.DONE if told else Until.TIMEOUT)
    subdivision = shown.get(Verb.SET_SUBDIVISION, {"subdivision": SUBDIVISION})["subdivision"]
    wanted = declared.counts_of(probe.dialect, command, pulses, subdivision)
    text = f"{pulses} pulses go another way after settings {when}"
    probe.expect(went, near=wanted, within=max(3, wanted // 8), unit="counts", refutes=text, exchange=exchange)
    if Verb.SET_RESPOND in shown:
        effect = setting_effects.BY_VERB[Verb.SET_RESPOND]
        assert effect.expected is not None  # it decides what a motion is answered with
        statuses = without_repeats(arriving.statuses((exchange,), command))
        seen = " then ".join(map(str, statuses)) or "silence"
        _expect_shown(probe, seen, effect.expected(probe.dialect, shown[Verb.SET_RESPOND]), "what a move is answered", when)


@anew
def _moved(probe: Probe, command: Command, values: Mapping[str, int], until: Until) -> tuple[Exchange, int]:
    """Move from rest to rest; return what was said, and how many counts the shaft went."""
    start = setting_effects.counts(probe)
    exchange = probe.ask(command, values, until=until, timeout_ns=_MOVE_NS)
    motion.wait_standing(probe)
    return exchange, abs(setting_effects.counts(probe) - start)


def _expect_shown(probe: Probe, seen: Any, wanted: Any, what: str, when: str) -> None:
    probe.expect(str(seen), equal=str(wanted), refutes=f"{what} is not what was set {when}")


# --- switches -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Deed:
    """Something that a drive is told to do, and what is read then. `but_in`: conditions in which it does something else.

    `to`: whom it is sent to.
    """

    name: str
    values: Mapping[str, int]
    expect: Callable[[Probe, Exchange, str], None]
    but_in: tuple[str, ...] = ()
    to: str = _OWN

    def is_for(self, dialect: Dialect, condition: Condition) -> bool:
        """Say whether a drive can be told it in a condition."""
        heard = {_OWN: True, _ALL: dialect.broadcast is not None, _GROUP: condition.name == "grouped"}[self.to]
        known = dialect.by_name.get(self.name)
        wears = known is None or Risk.WEAR in known.all_risks
        return heard and not wears and condition.stands and condition.name not in self.but_in


def _is_zero(probe: Probe, exchange: Exchange, when: str) -> None:
    turn = probe.dialect.counts_per_turn
    parts = probe.reply(probe.ask(Verb.READ_ENCODER_CARRY)).values
    seen = {
        "the position": probe.read(Verb.READ_POSITION, "position"),
        "carry and value": parts["carry"] * turn + parts["encoder"],
    }
    for what, counts in seen.items():
        text = f"{what} is not zero after {exchange.command.name if exchange.command else ''} {when}"
        probe.expect(counts, near=0, unit="counts", refutes=text, exchange=exchange)


def _is(on: bool) -> Callable[[Probe, Exchange, str], None]:
    def expect(probe: Probe, exchange: Exchange, when: str) -> None:
        text = f"a motor that is switched {'on' if on else 'off'} {when} reads otherwise"
        # Of some dialects nothing tells it.
        if (seen := motion.is_on(probe)) is not None:
            probe.expect(seen, equal=on, refutes=text, exchange=exchange)

    return expect


def _stands(probe: Probe, exchange: Exchange, when: str) -> None:
    motion.wait_standing(probe)


def _reads_position(position: int) -> Callable[[Probe, Exchange, str], None]:
    def expect(probe: Probe, exchange: Exchange, when: str) -> None:
        text = f"the position is not what is set {when}"
        seen = motion.position(probe)
        probe.expect(seen.value, near=position / 100, within=motion.miss(probe), refutes=text, exchange=exchange)

    return expect


def _within_a_turn(probe: Probe, exchange: Exchange, when: str) -> None:
    text = f"93 does not drop the turns {when}"
    probe.expect(abs(motion.position(probe).value), at_most=360, unit="degrees", refutes=text, exchange=exchange)


def _reads_ports(alm: int, pend: int) -> Callable[[Probe, Exchange, str], None]:
    def expect(probe: Probe, exchange: Exchange, when: str) -> None:
        got = {port: probe.read(Verb.READ_IO, port) for port in ("alm", "pend")}
        text = f"ports that are written {when} read otherwise"
        probe.expect(got, equal={"alm": alm, "pend": pend}, refutes=text, exchange=exchange)

    return expect


def _ports(alm: int, pend: int) -> Mapping[str, int]:
    return {"alm_mask": 1, "pend_mask": 1, "alm": alm, "pend": pend}


_NO_SWITCH = ("pulse-mode", "protected", "error")
_DEEDS = (
    _Deed("set_zero", {}, _is_zero),
    _Deed("set_position", {"position": 12_345}, _reads_position(12_345)),
    _Deed("set_position", {"position": -123_456_789}, _reads_position(-123_456_789)),
    _Deed("clear_turns", {}, _within_a_turn),
    _Deed("enable", {"enabled": 0}, _is(False), _NO_SWITCH),
    _Deed("enable", {"enabled": 1}, _is(True), _NO_SWITCH),
    _Deed("enable", {"enabled": 0}, _is(False), _NO_SWITCH, _ALL),
    _Deed("enable", {"enabled": 1}, _is(True), _NO_SWITCH, _ALL),
    _Deed("enable", {"enabled": 0}, _is(False), _NO_SWITCH, _GROUP),
    _Deed("enable", {"enabled": 1}, _is(True), _NO_SWITCH, _GROUP),
    _Deed("motor_off", {}, _is(False), _NO_SWITCH),
    _Deed("motor_on", {}, _is(True), _NO_SWITCH),
    _Deed("emergency_stop", {}, _stands, ("pulse-mode",)),
    _Deed("stop", {}, _stands),
)
#: What is written to the ports cannot be read, and so not be put back: it runs where it is told what to put back.
_PORTS = (
    _Deed("write_io", _ports(0, 1), _reads_ports(0, 1)),
    _Deed("write_io", _ports(1, 0), _reads_ports(1, 0)),
    _Deed("write_io", {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0}, lambda probe, exchange, when: None),
)


def _switches_cases(dialect: Dialect) -> Iterator[Case]:
    known = dialect.by_name
    for condition in _conditions(dialect):
        for kind, every in (("switches", _DEEDS), ("ports", _PORTS)):
            deeds = [deed for deed in every if deed.is_for(dialect, condition)]
            if not deeds:
                continue
            risks = frozenset[Risk]().union(*(known[d.name].risks(d.values) for d in deeds))
            facts = condition.facts(dialect, *risks) | {"commands": tuple(dict.fromkeys(d.name for d in deeds))}
            facts["alone"] |= any(deed.to != _OWN for deed in deeds)
            given = {"condition": condition, "when": condition.when, "deeds": deeds, "kind": kind}
            yield Case(dialect, given=given, facts=facts)


@_in_conditions(each=_switches_cases, name="{kind}/{condition}", refuted_by="a refusal, silence, or no effect of it")
def _switches(probe: Probe, condition: Condition, deeds: list[_Deed]) -> None:
    """What switches a drive, sets its zero or writes its ports does so {when}."""
    motion.ready_to_move(probe, condition.mode)
    arriving.follow(probe, declared.any_move(probe.dialect, at_speed=True), 100, rpm=120)
    condition.enter(probe)
    for deed in deeds:
        command = probe.command(deed.name)
        if deed.to != _OWN:
            exchange = _told_all(probe, command, deed.values, deed.to)
        else:
            exchange = _asked(probe, command, deed.values, condition.when)
        if can_refuse(command) and deed.to == _OWN:
            text = f"{deed.name} {_text(deed.values)} is refused {condition.when}"
            holds = not probe.refused(exchange)
            probe.expect(received_text(exchange), holds=holds, expected="no refusal", refutes=text, exchange=exchange)
        deed.expect(probe, exchange, condition.when)
    condition.leave(probe)
