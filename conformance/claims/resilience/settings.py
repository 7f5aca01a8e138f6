"""Settings in every condition: what is set at rest is set while the shaft turns, is off, was stopped or protected.

A covering array tells what is tried: every setting in every condition, and each with every kind of value and of address in
some of them. What is stored is read at once and again behind all the others; where no read shows it, a move and a homing do.

Rules kept here:
- While the shaft turns nothing is set that may change how it turns.
- What is refused leaves what was set before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Form, Verb
from conformance.claim import Theme
from conformance.claims import conditions
from conformance.claims.addressing.ways import group_of
from conformance.claims.conditions import Condition
from conformance.claims.control_reads import is_exception, received_text
from conformance.claims.declare import Case, claim
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import expect_goes
from conformance.claims.motion.told import expect_states, states
from conformance.claims.settings import setting_effects
from conformance.claims.settings.effects_together import SILENT_NS, SPEED_SHARE, expect_effects, home_by_a_switch
from conformance.claims.settings.known_settings import ReadableSetting, Setting, every_setting, needs
from conformance.claims.settings.setting_effects import by_action
from conformance.model import covering, lk_parameters
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import MOVES, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk.acceptance import Acceptance, can_refuse
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe

#: What is sent: either of two sets of values, or from the third on those that the manual forbids; and to whom.
_ONE, _OTHER = 0, 1
OWN, ALL, GROUP = "own", "all", "group"
#: What may change how a turning shaft turns, or whether it is told.
_AT_REST_ALONE = frozenset(
    {Verb.SET_WORK_MODE, Verb.SET_RESPOND, Verb.SET_DIRECTION, Verb.SET_ENABLE_LEVEL, Verb.SET_CURRENT, Verb.SET_HOME}
)


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


def _rows(dialect: Dialect) -> Iterator[tuple[Condition, list[_Row]]]:
    every = {each.name: each for each in conditions.passing(dialect)}
    chosen = {each.name: each for each in every_setting(dialect)}

    def is_allowed(condition: str, setting: str) -> bool:
        own = every[condition].settings
        command = chosen[setting].command
        if any(name in own for name in chosen[setting].names) or (command.modes and "work_mode" in own):
            return False
        return every[condition].stands or command.verb not in _AT_REST_ALONE

    def can_be_wrong(setting: str, value: int, to: str) -> bool:
        return value <= _OTHER or (to == OWN and value < 2 + wrong[setting])

    def shows(setting: str, to: str) -> bool:
        return (
            to == OWN or isinstance(chosen[setting], ReadableSetting) or by_action(dialect, chosen[setting].command) is not None
        )

    def is_heard(condition: str, to: str) -> bool:
        return to != GROUP or condition == "grouped"

    places = {name: place for place, name in enumerate(chosen)}
    wrong = {name: len(each.wrong) for name, each in chosen.items()}
    factors = {
        "condition": list(every),
        "setting": list(chosen),
        "value": range(2 + max(wrong.values(), default=0)),
        "to": (OWN, *((ALL,) if dialect.broadcast is not None else ()), *((GROUP,) if "grouped" in every else ())),
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
                row["to"] != OWN,
            )
        )
        found = [_Row(chosen[row["setting"]], row["value"], row["to"]) for row in of_condition]
        # A value that is refused leaves one that is taken in this condition.
        alone = [row for row in found if row.is_wrong and not any(o.setting is row.setting and not o.is_wrong for o in found)]
        taken = {row.setting.name: _Row(row.setting, _ONE, OWN) for row in alone}
        yield condition, [each for row in found for each in (taken.pop(row.setting.name, None), row) if each is not None]


def _settings_cases(dialect: Dialect) -> Iterator[Case]:
    for condition, rows in _rows(dialect):
        risks, names = needs(row.setting for row in rows)
        facts = condition.facts(dialect, *risks, settings=names)
        facts |= {
            "alone": dialect.broadcast is not None,
            "commands": tuple(dict.fromkeys(r.setting.command.name for r in rows)),
        }
        yield Case(dialect, given={"condition": condition, "when": condition.when, "rows": rows}, facts=facts)


in_conditions = partial(
    claim,
    Theme.RESILIENCE,
    section=lambda case: case.dialect.by_verb[Verb.RUN_SPEED].section,
    at_best=Certainty.LIKELY,
    parameters={},
)

# --- settings -----------------------------------------------------------------------------------------------------------


@in_conditions(
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
            home_by_a_switch(probe)
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
        text, within = f"settings change the speed of the shaft {condition.when}", 6 + abs(turning.value) * SPEED_SHARE
        probe.expect(motion.speed(probe).value, near=turning.value, within=within, unit="rpm", refutes=text)
    condition.leave(probe)
    motion.wait_standing(probe)
    if before:
        expect_states(probe, before, f"behind settings {condition.when}")
    for row in rows:
        if isinstance(row.setting, ReadableSetting):
            _expect_stored(probe, row.setting, held, f"{condition.when}, and other settings behind it")
    expect_effects(probe, [row.setting for row in rows], held, condition.when, homing)


def _set(probe: Probe, row: _Row, when: str, held: dict[str, Mapping[str, int]]) -> None:
    """Send a setting, judge its reply, and note the value that must hold from then on."""
    setting, command = row.setting, row.setting.command
    values = row.values
    if isinstance(setting, ReadableSetting) and not row.is_wrong:
        values = setting.other(held[setting.name], row.value)
    if row.to != OWN:
        told_all(probe, command, values, row.to, setting.form)
    else:
        _expect_reply(probe, setting, values, Acceptance.REFUSED if row.is_wrong else Acceptance.DONE, when)
    if not row.is_wrong:
        held[setting.name] = values
    if isinstance(setting, ReadableSetting):
        _expect_stored(probe, setting, held, when)


def told_all(probe: Probe, command: Command, values: Mapping[str, int], to: str, form: Form | None = None) -> Exchange:
    """Send something to all drives, or to a group; that is not answered."""
    address = probe.dialect.broadcast if to == ALL else group_of(probe.dialect, probe.address)
    return probe.send(probe.build(command, values, address=address, form=form).item(), timeout_ns=SILENT_NS)


def _expect_reply(probe: Probe, setting: Setting, values: Mapping[str, int], wanted: Acceptance, when: str) -> None:
    command = setting.command
    exchange = asked(probe, command, values, when, setting=setting)
    text = f"{setting.name} {values_text(values)} is not {wanted.value} {when}"
    if can_refuse(command):
        answer = probe.reply(exchange)
        refused = probe.refused(exchange) or is_exception(answer)
        holds = refused is (wanted is Acceptance.REFUSED)
        probe.expect(received_text(exchange), holds=holds, expected=wanted.value, refutes=text, exchange=exchange)
    else:
        answered = {name: value for name, value in probe.reply(exchange).values.items() if name in values}
        probe.expect(answered, equal=dict(values), refutes=text, exchange=exchange)


def asked(probe: Probe, command: Command, values: Mapping[str, int], when: str, setting: Setting | None = None) -> Exchange:
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


def values_text(values: Mapping[str, int]) -> str:
    """Return values for people."""
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


@in_conditions(each=_of_no_motion, name="settings/leave-motion", refuted_by="another speed or way, or a refusal")
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
        within = _NEARLY * SPEED_SHARE
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
