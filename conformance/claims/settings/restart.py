"""Restart and power: a drive keeps what it stores, and loses what it holds only while it runs.

    NAME/power                            a setting that is not the default is there after the power was cut
    restart/motion-as-before              each motion is what it was
    restart/ends-motion                   one that is under way ends
    set_axis_lock/at-power-on             the shaft is held or free when the drive begins in each bus mode (CAN)
    parameter/NAME/power                  a control parameter (LK) is as before when power comes on

Rules kept here:
- A setting that can be read is read, another one is seen by its effect (`settings.setting_effects`).
- A run and a zero that are kept for power-on have modules of their own; how long a restart takes is for the theme timing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial

from analyzer import dialects as registry
from analyzer.catalogue import Certainty, Command, Dialect, Form, MotionKind, Risk, Verb
from analyzer.layout import Effect
from conformance.claim import Inconclusive, NotRun
from conformance.claims import bench
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.claims.ranges import edges
from conformance.claims.settings import kept_effects, setting_effects
from conformance.claims.settings.kept_effects import Kept
from conformance.claims.settings.kept_run import ENDS, BeginsAgain
from conformance.claims.settings.known_settings import every_setting
from conformance.claims.settings.link_changes import (
    NEW_ADDRESS_ANSWERS,
    SETTLE_NS,
    another_rate,
    ask_in,
    at_rate,
    change_address,
    expect_not_refused,
    is_reply,
    need_reply_or_silence,
    other_address,
)
from conformance.claims.settings.read_back import expect_values, fields_of, of_read_back, parameters, text
from conformance.claims.settings.setting_effects import SettingEffect
from conformance.model import lk_parameters
from conformance.model.lk_parameters import number_of, read_parameter
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import QUICK, RUNS_AND_MOVES
from conformance.talk import settings
from conformance.talk.acceptance import answers, need_reliable_replies
from conformance.talk.probe import MS, Probe
from conformance.talk.restarts import DEAF_NS, power_cycle, restart, wait_for_answer

#: How long a drive that cannot be asked meanwhile may take to come back.
RESTORED_NS = 4_000 * MS
#: The speed of a run, and as what share of it two are one.
_RPM, _SHARE = 60, 0.1
#: How long a shaft is watched that is to stand.
_LOOK_NS = 300 * MS
#: How long a drive takes to start, and its shaft to have the speed of a motion that is taken up again.
_START_NS, _RESUMES_NS = 3_000 * MS, 1_000 * MS
#: Beyond the highest speed of an open mode, as sent, at 8 subdivisions.
_BEYOND = 1_200


def stored_effect(dialect: Dialect, command: Command) -> SettingEffect | None:
    """Return how a stored setting shows, None for those that do not show or that other claims judge."""
    if Verb.RESTART not in dialect.by_verb or settings.changes_link(command) or command.verb is Verb.ENABLE:
        return None
    return setting_effects.of(dialect, command)


def _restart_risks(case: Case) -> frozenset[Risk]:
    assert case.command is not None  # only cases of commands are asked for
    return case.command.all_risks | case.dialect.by_verb[Verb.RESTART].all_risks


_of_restart = partial(of_read_back, name="{command}/restart", risks=_restart_risks)


# --- settings ---------------------------------------------------------------------------------------------------------


def _kept_settings(dialect: Dialect) -> Iterator[Case]:
    together = {each.command.name for each in every_setting(dialect)}
    for command in dialect.commands:
        effect = stored_effect(dialect, command)
        if effect is not None:
            one, _ = effect.pair(command.request_forms[0])
            needs = edges.needs(dialect, command, [one])
            for end, how, begin_again in ENDS:
                if end == "restart" and command.name in together:
                    continue
                more = dialect.by_verb[Verb.RESTART].all_risks if end == "restart" else ()
                facts = effect.needed(dialect, needs, *more) | {"parameters": {}, "emulated": end == "power"}
                yield Case(dialect, command, {"effect": effect, "end": end, "how": how, "begin_again": begin_again}, facts)


@of_read_back(each=_kept_settings, name="{command}/{end}", refuted_by="another setting", fields=fields_of)
def _kept(probe: Probe, command: Command, effect: SettingEffect, how: str, begin_again: BeginsAgain) -> None:
    """What {command} set is there after {how}."""
    form = command.request_forms[0]
    values, _ = effect.pair(form)
    effect.ready(probe)
    edges.prepare(probe, command)
    exchange = probe.do(command, edges.plain(probe, command, form, **values))
    before = effect.see(probe)
    begin_again(probe)
    if effect.moves and command.verb is not Verb.SET_WORK_MODE:
        motion.ready_to_move(probe)
    after = effect.see(probe)
    text = f"{command.name} after {how}: {effect.words(after)}"
    effect.expect(probe, after, before, text, exchange, f"{command.name} lost")


def _kept_fields(dialect: Dialect) -> Iterator[Case]:
    if Verb.RESTART in dialect.by_verb:
        for command, row in kept_effects.rows(dialect):
            facts = row.effect.needed(
                dialect,
                edges.needs(dialect, command, [row.values]),
                *dialect.by_verb[Verb.RESTART].all_risks,
                *declared.risks(dialect),
            )
            # They take long, and the whole command is looked at by a claim that every run makes.
            facts |= {"parameters": {"field": row.name}, "emulated": row.hands, "by_name": not row.hands}
            yield Case(dialect, command, {"row": row}, facts)


@of_read_back(each=_kept_fields, name="{command}/restart-{row}", refuted_by="another setting", fields=fields_of)
def _kept_field(probe: Probe, command: Command, row: Kept) -> None:
    """A restart keeps {row}, as {command} set it."""
    motion.ready_to_move(probe)
    row.effect.ready(probe)
    exchange = probe.do(command, edges.plain(probe, command, command.request_forms[0], **row.values))
    before = row.effect.see(probe)
    restart(probe)
    row.effect.ready(probe)
    row.effect.expect(probe, row.effect.see(probe), before, f"a restart loses {row.name}", exchange)


@_of_restart(each=commands(Verb.WRITE_USER_ID), refuted_by="another number", fields=fields_of, settings=fields_of)
def _user_id(probe: Probe, command: Command) -> None:
    """A restart keeps the user's number."""
    field = next(iter(command.request_forms[0].layout.named.values()))
    # Memory that is empty reads as the highest number.
    for number in (0x01020304, field.high):
        wanted = {field.name: number}
        probe.do(command, wanted)
        exchange = restart(probe)
        got = {field.name: probe.read(Verb.READ_USER_ID)}
        expect_values(probe, command, wanted, got, exchange, "after a restart")


def _addresses(dialect: Dialect) -> Iterator[Case]:
    if Verb.RESTART in dialect.by_verb:
        for command, field in dialect.effects(Effect.ADDRESS):
            yield Case(dialect, command, {}, {"fields": (field.name,), "settings": (field.name,)})


@_of_restart(each=_addresses, refuted_by="an answer at another address", alone=True, quirks=may_meet(NEW_ADDRESS_ANSWERS))
def _address(probe: Probe, command: Command) -> None:
    """A restart keeps the address."""
    before, away = probe.address, other_address(probe.dialect)
    move_away(probe, command)
    exchange = probe.ask(Verb.RESTART, address=away)
    with contextlib.suppress(Inconclusive):
        wait_for_answer(probe, before, away, limit_ns=RESTORED_NS)
    here, there = answers(probe, before), answers(probe, away)
    if there:
        change_address(probe, command, before, at=away)
    probe.expect(
        f"an answer at {before}" if here else "silence at both",
        holds=there,
        expected=f"an answer at {away}",
        refutes=f"{command.name}: a restart loses the address",
        exchange=exchange,
        key=f"{command.name} lost",
    )


def move_away(probe: Probe, command: Command) -> None:
    """Give the drive another address. Raises Inconclusive where it does not answer there."""
    need_reliable_replies(probe)
    away = other_address(probe.dialect)
    change_address(probe, command, away)
    if not answers(probe, away):
        raise Inconclusive(f"the drive does not answer at {away}, which it was given")


def _kept_links(effect: Effect) -> Cases:
    def cases(dialect: Dialect) -> Iterator[Case]:
        if Verb.RESTART in dialect.by_verb and dialect.bus == "serial":
            for command, field in dialect.effects(effect):
                yield Case(dialect, command, {"field": field.name}, {"fields": (field.name,), "settings": (field.name,)})

    return cases


@_of_restart(each=_kept_links(Effect.BAUD_RATE), refuted_by="silence at the new speed", alone=True)
def _speed_of_the_line(probe: Probe, command: Command) -> None:
    """A restart keeps the speed of the line."""
    need_reliable_replies(probe)
    other = another_rate(probe)
    with at_rate(probe, other) as exchange:
        expect_not_refused(probe, command, other, exchange)
        if not answers(probe, probe.address):
            raise Inconclusive(f"the drive does not answer at {other} bits per second")
        probe.ask(Verb.RESTART)
        with contextlib.suppress(Inconclusive):
            wait_for_answer(probe, limit_ns=RESTORED_NS)
        kept = answers(probe, probe.address)
    text = f"{command.name}: a restart loses the speed of the line"
    expected = f"an answer at {other}"
    probe.expect("silence", holds=kept, expected=expected, refutes=text, exchange=exchange, key=f"{command.name} lost")


@_of_restart(each=_kept_links(Effect.DIALECT), refuted_by="an answer in the old dialect", alone=True)
def _dialect_of_the_line(probe: Probe, command: Command, field: str) -> None:
    """A restart keeps the dialect."""
    own, sibling = probe.dialect, registry.get(probe.dialect.siblings[0])
    if probe.address > sibling.addresses[1]:
        raise NotRun(f"a drive at {probe.address} cannot speak {sibling.name}")
    need_reliable_replies(probe)
    assert own.chosen_by is not None
    assert sibling.chosen_by is not None
    exchange = probe.ask(command, {field: sibling.chosen_by})
    expect_not_refused(probe, command, sibling.chosen_by, exchange)
    probe.wait(SETTLE_NS)
    ask_in(probe, sibling, sibling.by_verb[Verb.RESTART].name)
    probe.wait(DEAF_NS)
    motion.wait_until(
        probe, lambda: is_reply(sibling, probe.address, ask_in(probe, sibling, "read_speed")), limit_ns=RESTORED_NS
    )
    answer = ask_in(probe, sibling, "read_speed")
    ask_in(probe, sibling, command.name, {field: own.chosen_by})
    probe.wait(SETTLE_NS)
    need_reply_or_silence(sibling, probe.address, answer)
    kept = is_reply(sibling, probe.address, answer)
    text, expected = f"{command.name}: a restart loses the dialect", f"a reply in {sibling.name}"
    probe.expect("silence", holds=kept, expected=expected, refutes=text, exchange=exchange, key=f"{command.name} lost")


# --- motion after a restart ---------------------------------------------------------------------------------------------


def _risks_of_all_motions(case: Case) -> frozenset[Risk]:
    every = (*case.dialect.motions(*RUNS_AND_MOVES), case.dialect.by_verb[Verb.SET_DIRECTION])
    return declared.risks(case.dialect, *_restart_risks(case).union(*(c.all_risks for c in every)))


@of_read_back(
    each=commands(Verb.RESTART),
    name="{command}/motion-as-before",
    refuted_by="another distance or speed, or the other way",
    risks=_risks_of_all_motions,
    settings=lambda case: declared.settings(case.dialect, "motor_direction"),
    at_best=Certainty.LIKELY,
)
def _motion_as_before(probe: Probe, command: Command) -> None:
    """After a restart each motion is as far, as fast and the same way as before, by the stored mode, subdivision, direction."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[0], subdivision=8)
    probe.do(Verb.SET_DIRECTION, {"motor_direction": 1})
    before = _each_motion(probe)
    motion.run_at(probe, _RPM, QUICK)
    exchange = restart(probe)
    place = motion.position(probe)
    probe.wait(_LOOK_NS)
    moved = motion.position(probe).value - place.value
    motion.ready_to_move(probe)
    motion.stand_still(probe)
    text = "the shaft turns after a restart in a run"
    probe.expect(moved, near=0, unit="degrees", refutes=text, exchange=exchange)
    for name, seen in _each_motion(probe).items():
        text = f"{name} is another motion after a restart"
        probe.expect(seen, near=before[name], within=max(2.0, abs(before[name]) * _SHARE), refutes=text, exchange=exchange)


def _each_motion(probe: Probe) -> dict[str, float]:
    """Return what each motion does: the degrees of a move, and the rpm of a run beyond what its mode can."""
    found = {}
    for command in probe.dialect.motions(*RUNS_AND_MOVES):
        how = {"subdivision": 8, "acceleration": QUICK}
        if command.motion is not None and command.motion.kind is MotionKind.RUN:
            # Beyond 400 rpm as sent, so that the limit of the mode shows too.
            motion.begin(probe, command, rpm=_BEYOND, **how)
            probe.wait(700 * MS)
            found[command.name] = motion.speed(probe).value
            motion.stand_still(probe)
        else:
            found[command.name] = arriving.follow(probe, command, 90, rpm=120, **how).degrees
    return found


def _locks(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.SET_AXIS_LOCK)(dialect):
        for value, word in ((0, "disabled"), (1, "enabled")):
            yield Case(dialect, case.command, {"value": value, "word": word})


@of_motion(
    each=_locks,
    name="{command}/at-power-on-{value}",
    refuted_by="the other state",
    emulated=True,
    risks=risks_by(Verb.SET_AXIS_LOCK, Verb.ENABLE, Verb.RESTART),
    settings=("axis_lock",),
)
def _locked(probe: Probe, command: Command, value: int) -> None:
    """With axis_lock {value} the motor is {word} when a bus mode is set, after a restart and when power comes on in it."""
    motion.ready_to_move(probe)
    probe.do(command, {"axis_lock": value})
    modes = probe.command(Verb.SET_WORK_MODE)
    for mode in declared.bus_modes(probe.dialect):
        motion.set_mode(probe, declared.pulse_modes(probe.dialect)[0])
        exchange = probe.do(modes, {"work_mode": declared.choice(modes, "work_mode", mode)})
        probe.wait(_START_NS)
        text = f"with axis_lock {value} the motor is in the other state when {mode} is set"
        probe.expect(probe.read(Verb.READ_ENABLED, "enabled"), equal=value, refutes=text, exchange=exchange)
        for _, how, begin_again in ENDS:
            # A motor that is as before has not begun anew.
            motion.switch(probe, not value)
            begin_again(probe)
            probe.wait(_START_NS)
            text = f"with axis_lock {value} the motor is in the other state in {mode} after {how}"
            probe.expect(probe.read(Verb.READ_ENABLED, "enabled"), equal=value, refutes=text)
            bench.expect_hold(probe, bool(value), f"with axis_lock {value} in {mode} after {how}")


def _restarts(dialect: Dialect) -> Iterator[Case]:
    """Yield the restart in the work mode of the suite, which is the last one by the bus, and in each of the others."""
    for case in commands(Verb.RESTART)(dialect):
        yield Case(dialect, case.command, {"mode": "", "where": "", "in_mode": ""})
        for mode in declared.bus_modes(dialect)[:-1]:
            yield Case(dialect, case.command, {"mode": mode, "where": f"-{mode}", "in_mode": f" in {mode}"})


@of_motion(
    each=_restarts,
    name="{command}/ends-motion{where}",
    statement="A restart ends a motion{in_mode}, and it is not taken up again.",
    refuted_by="a shaft that still turns",
    risks=risks_by(Verb.RUN_SPEED),
    parameters={},
    at_best=Certainty.LIKELY,
)
def _ends_motion(probe: Probe, command: Command, mode: str) -> None:
    motion.ready_to_move(probe, mode)
    motion.run_at(probe, 60, QUICK)
    probe.wait(500 * MS)
    exchange = probe.ask(command)
    wait_for_answer(probe)
    probe.wait(_RESUMES_NS)
    seen = motion.speed(probe)
    stands = abs(seen.value) < 1 + seen.noise
    if not stands:
        motion.stop(probe)
    text = "a run goes on after a restart"
    probe.expect(seen, holds=stands, expected="0 rpm", unit="rpm", refutes=text, exchange=exchange)


# --- control parameters (LK) ------------------------------------------------------------------------------------------


@of_read_back(each=parameters, name="parameter/{form}/power", refuted_by="the written value", emulated=True)
def _lost(probe: Probe, command: Command, form: Form) -> None:
    """{form} is as before when power comes on."""
    before = read_parameter(probe, number_of(form))
    exchange = probe.do(command, lk_parameters.moderate(form, 0))
    if read_parameter(probe, number_of(form)) == before:
        raise Inconclusive(f"{form.name} does not change, so nothing can be lost")
    power_cycle(probe)
    after = read_parameter(probe, number_of(form))
    probe.expect(
        text(after),
        holds=after == before,
        expected=text(before),
        refutes=f"{form.name} written by 0xC1 survives the power",
        exchange=exchange,
        key="parameter survives",
    )
