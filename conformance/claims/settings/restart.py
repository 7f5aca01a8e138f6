"""Restart and power: a drive keeps what it stores, and loses what it holds only while it runs.

    NAME/power                            a setting that is not the default is there after the power was cut
    save_speed/restart, clean             a kept run begins again, a forgotten one does not
    set_zero_mode/restart                 the shaft goes back to the kept zero
    parameter/NAME/power                  a control parameter (LK) is as before when power comes on

Rules kept here:
- A setting that can be read is read, another one is seen by its effect (`settings.setting_effects`).
- What a restart does to motion, and how long it takes, is for other themes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial
from itertools import combinations, pairwise
from math import copysign
from typing import NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Form, MotionKind, Risk, Trait, Verb
from analyzer.layout import Effect
from conformance.claim import Inconclusive, NotRun, Refuted
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.ranges import edges
from conformance.claims.settings import kept_effects, setting_effects
from conformance.claims.settings.kept_effects import Kept
from conformance.claims.settings.known_settings import every_setting
from conformance.claims.settings.link_changes import (
    NEW_ADDRESS_ANSWERS,
    SETTLE_NS,
    ask_in,
    change_address,
    follow,
    is_reply,
    need_reply_or_silence,
    other_address,
    settle,
)
from conformance.claims.settings.read_back import expect_values, fields_of, of_read_back, parameters, text
from conformance.claims.settings.setting_effects import STEEP, SettingEffect
from conformance.model import lk_parameters
from conformance.model.lk_parameters import number_of, read_parameter
from conformance.motion import arriving, motion
from conformance.motion.motion import MS
from conformance.talk import settings
from conformance.talk.acceptance import answers, need_reliable_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe
from conformance.talk.restarts import DEAF_NS, need_axis_lock, power_cycle, restart, wait_for_answer

#: How long a drive that cannot be asked meanwhile may take to come back.
RESTORED_NS = 4_000 * MS
_RPM = 60
#: Speeds that are one, as a share; counts within which a shaft is where it should be.
_SHARE, _PLAY = 0.1, 100
#: Speeds of the line that each drive has, of which one is another than that of the line.
_OTHER_RATES = (19_200, 38_400)
#: How long a shaft is watched that is to stand.
_LOOK_NS = 300 * MS
#: Beyond the highest speed of an open mode, as sent, at 8 subdivisions.
_BEYOND = 1_200
#: A run whose speed takes two bytes, and whose ramp takes two seconds.
_FAST_RPM, _LONG_RAMP, _RAMP_NS = 600, 192, 2_000 * MS
#: What keeps a run, and what makes the drive forget it.
_KEEP, _FORGET = {"save_state": 0xC8}, {"save_state": 0xCA}


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
            for end, how in (("restart", "a restart"), ("power", "the power was cut")):
                if end == "restart" and command.name in together:
                    continue
                more = dialect.by_verb[Verb.RESTART].all_risks if end == "restart" else ()
                facts = effect.needed(dialect, needs, *more) | {"parameters": {}, "emulated": end == "power"}
                yield Case(dialect, command, {"effect": effect, "end": end, "how": how}, facts)


@of_read_back(each=_kept_settings, name="{command}/{end}", refuted_by="another setting", fields=fields_of)
def _kept(probe: Probe, command: Command, effect: SettingEffect, end: str, how: str) -> None:
    """What {command} set is there after {how}."""
    form = command.request_forms[0]
    values, _ = effect.pair(form)
    effect.ready(probe)
    edges.prepare(probe, command)
    exchange = probe.do(command, edges.plain(probe, command, form, **values))
    before = effect.see(probe)
    if end == "power":
        power_cycle(probe)
    else:
        restart(probe)
    if effect.moves and command.verb is not Verb.SET_WORK_MODE:
        motion.ready_to_move(probe)
    after = effect.see(probe)
    probe.expect(
        effect.words(after),
        holds=effect.same(probe, before, after),
        expected=effect.words(before),
        refutes=f"{command.name} after {how}: {effect.words(after)}",
        exchange=exchange,
        key=f"{command.name} lost",
    )


def _kept_fields(dialect: Dialect) -> Iterator[Case]:
    if Verb.RESTART in dialect.by_verb:
        for command, row in kept_effects.rows(dialect):
            facts = row.effect.needed(
                dialect, edges.needs(dialect, command, [row.values]), *_restarting(dialect), *motion.risks(dialect)
            )
            # They take long, and the whole command is looked at by a claim that every run makes.
            facts |= {"parameters": {"field": row.name}, "emulated": row.hands, "by_name": not row.hands}
            yield Case(dialect, command, {"row": row}, facts)


def _restarting(dialect: Dialect) -> frozenset[Risk]:
    return dialect.by_verb[Verb.RESTART].all_risks


@of_read_back(each=_kept_fields, name="{command}/restart-{row}", refuted_by="another setting", fields=fields_of)
def _kept_field(probe: Probe, command: Command, row: Kept) -> None:
    """A restart keeps {row}, as {command} set it."""
    motion.ready_to_move(probe)
    row.effect.ready(probe)
    exchange = probe.do(command, edges.plain(probe, command, command.request_forms[0], **row.values))
    before = row.effect.see(probe)
    restart(probe)
    row.effect.ready(probe)
    after = row.effect.see(probe)
    text = f"a restart loses {row.name}"
    holds, expected = row.effect.same(probe, before, after), row.effect.words(before)
    probe.expect(row.effect.words(after), holds=holds, expected=expected, refutes=text, exchange=exchange)


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
def _speed_of_the_line(probe: Probe, command: Command, field: str) -> None:
    """A restart keeps the speed of the line."""
    need_reliable_replies(probe)
    codes = {rate: value for value, rate in probe.dialect.rates.items()}
    before = probe.gate.line.endpoint.bits_per_second
    other = next(rate for rate in _OTHER_RATES if rate != before)
    if before not in codes:
        raise Inconclusive(f"the line is at {before} bits per second, which is no setting of the drive")
    exchange = probe.ask(command, {field: codes[other]})
    follow(probe, other)
    try:
        settle(probe)
        if not answers(probe, probe.address):
            raise Inconclusive(f"the drive does not answer at {other} bits per second")
        probe.ask(Verb.RESTART)
        with contextlib.suppress(Inconclusive):
            wait_for_answer(probe, limit_ns=RESTORED_NS)
        kept = answers(probe, probe.address)
        if kept:
            probe.ask(command, {field: codes[before]})
    finally:
        follow(probe, before)
    settle(probe)
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


# --- what happens at power-on -----------------------------------------------------------------------------------------


def _saved_runs(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.SAVE_SPEED)
    if command is not None:
        risks = command.risks(_KEEP) | command.risks(_FORGET) | motion.risks(dialect, Risk.UNBOUNDED)
        facts = {
            "fields": ("save_state",),
            "risks": risks | dialect.by_verb[Verb.RESTART].all_risks,
            "settings": motion.settings(dialect),
        }
        yield Case(dialect, command, {}, facts)


#: How long a run is given to end where it should not, to show its way on a long ramp, and what is damaged to be answered.
_GOES_ON_NS, _SHOWS_NS = 60 * MS, 150 * MS
_DAMAGED_NS = 60 * MS


def _turning(probe: Probe, rpm: int, mode: str = "") -> float:
    motion.ready_to_move(probe, mode, subdivision=motion.SUBDIVISION)
    motion.run_at(probe, rpm)
    probe.wait(200 * MS)
    return motion.speed(probe).value


def _after_restart(probe: Probe, stop: Verb = Verb.STOP_SPEED) -> tuple[float, Exchange]:
    """Stop the shaft at once, restart the drive, and return how fast it turns then."""
    command = probe.command(stop)
    probe.ask(command, {"acceleration": 0} if "acceleration" in command.request_forms[0].layout.named else None)
    motion.wait_standing(probe)
    exchange = restart(probe)
    probe.wait(600 * MS)
    return motion.speed(probe).value, exchange


def _forget(probe: Probe, command: Command) -> None:
    probe.ask(command, _FORGET)
    motion.stand_still(probe)


def _modes(dialect: Dialect) -> list[str]:
    return [mode for mode in motion.bus_modes(dialect) if "no_encoder" not in mode]


def _saved_in_a_mode(dialect: Dialect) -> Iterator[Case]:
    """Yield it for the mode between: in the others a run is kept by other claims."""
    for case in _saved_runs(dialect):
        yield Case(dialect, case.command, {"mode": _modes(dialect)[-2]}, case.facts)


@of_read_back(each=_saved_in_a_mode, name="{command}/restart", refuted_by="another speed, or none", rests_on=(Doubt.VALUES,))
def _saved(probe: Probe, command: Command, mode: str) -> None:
    """In {mode} a run that is kept goes on, and begins again after a restart, though the emergency stop ended it."""
    need_axis_lock(probe)
    before = _turning(probe, -_RPM, mode)
    exchange = probe.do(command, _KEEP)
    text = "a run does not go on when it is kept"
    within = max(2.0, abs(before) * _SHARE)
    probe.expect(motion.speed(probe).value, near=before, within=within, unit="rpm", refutes=text, exchange=exchange)
    after, exchange = _after_restart(probe, Verb.EMERGENCY_STOP)
    _forget(probe, command)
    probe.expect(
        after,
        near=before,
        within=max(2.0, abs(before) * _SHARE),
        unit="rpm",
        refutes=f"a kept run at {before:.0f} rpm is one at {after:.0f} rpm after a restart",
        exchange=exchange,
        key="saved run",
    )


def _saved_as_set(dialect: Dialect) -> Iterator[Case]:
    """Yield it with the setting of the direction turned, where that turns motion by the bus."""
    turns = Trait.DIRECTION_TURNS_BUS_MOTION in dialect.traits
    more = ("motor_direction",) if turns else ()
    for case in _saved_runs(dialect):
        yield Case(dialect, case.command, {"turns": turns}, {**case.facts, "settings": (*case.facts["settings"], *more)})


@of_read_back(each=_saved_as_set, name="{command}/as-it-was", refuted_by="another run, or none", rests_on=(Doubt.VALUES,))
def _saved_as_it_was(probe: Probe, command: Command, turns: bool) -> None:
    """In an open mode, at 8 subdivisions, a kept run has its speed, its way and its ramp after each of two restarts."""
    need_axis_lock(probe)
    motion.ready_to_move(probe, motion.bus_modes(probe.dialect)[0], subdivision=8)
    if turns:
        probe.do(Verb.SET_DIRECTION, {"motor_direction": 1})
    run = probe.command(Verb.RUN_SPEED)
    # A ramp that is still under way when the speed is first looked at, and a speed of two bytes.
    values = motion.values_of(probe.dialect, run, rpm=_FAST_RPM, acceleration=_LONG_RAMP, subdivision=8)
    probe.do(run, values)
    probe.do(command, _KEEP)
    probe.wait(_SHOWS_NS)
    wanted = copysign(_FAST_RPM, motion.speed(probe).value)
    for number in ("first", "second"):
        motion.stand_still(probe)
        exchange = restart(probe)
        early = motion.speed(probe)
        probe.wait(_RAMP_NS)
        seen = motion.speed(probe)
        text = f"a run kept at {wanted:+g} rpm and 8 subdivisions is another after the {number} restart"
        try:
            probe.expect(seen.value, near=wanted, within=_FAST_RPM * _SHARE, unit="rpm", refutes=text, exchange=exchange)
            text = "a run kept with a slow ramp begins without it"
            probe.expect(abs(early.value), at_most=_FAST_RPM * (1 - 2 * _SHARE), unit="rpm", refutes=text, exchange=exchange)
        except Refuted:
            _forget(probe, command)
            raise
    _forget(probe, command)


@of_read_back(each=_saved_runs, refuted_by="a shaft that turns", rests_on=(Doubt.VALUES,))
def _clean(probe: Probe, command: Command) -> None:
    """A run that was forgotten goes on, and does not begin after a restart, nor one that was kept with a wrong check alone."""
    before = _turning(probe, _RPM)
    probe.do(command, _KEEP)
    exchange = probe.do(command, _FORGET)
    probe.wait(_GOES_ON_NS)
    text, within = "a run does not go on when it is forgotten", max(2.0, abs(before) * _SHARE)
    probe.expect(motion.speed(probe).value, near=before, within=within, unit="rpm", refutes=text, exchange=exchange)
    _expect_forgotten(probe, command)


@of_read_back(each=_saved_runs, name="{command}/clean-at-rest", refuted_by="a shaft that turns", rests_on=(Doubt.VALUES,))
def _clean_at_rest(probe: Probe, command: Command) -> None:
    """A run that was forgotten when the shaft stood does not begin after a restart."""
    _turning(probe, -_RPM)
    probe.do(command, _KEEP)
    motion.stand_still(probe)
    probe.do(command, _FORGET)
    _expect_forgotten(probe, command)


def _expect_forgotten(probe: Probe, command: Command) -> None:
    built = probe.build(command, _KEEP)
    for check in probe.dialect.link.checks(built.frame, probe.address):
        changed = bytearray(built.frame)
        changed[check.start] ^= 1
        probe.send(built.item(bytes(changed)), timeout_ns=_DAMAGED_NS)
    after, exchange = _after_restart(probe)
    if abs(after) > 1 + probe.noise.rpm:
        _forget(probe, command)
    refutes = f"a forgotten run turns the shaft at {after:.0f} rpm after a restart"
    probe.expect(abs(after), at_most=1, unit="rpm", refutes=refutes, exchange=exchange, key="clean run")


def _zero_modes(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.SET_ZERO_MODE)
    if command is not None:
        fields = tuple(command.request_forms[0].layout.named)
        risks = command.risks({"zero_mode": 2}) | command.risks({"zero_mode": 0}) | motion.risks(dialect)
        facts = {
            "fields": fields,
            "risks": risks | dialect.by_verb[Verb.RESTART].all_risks,
            "settings": motion.settings(dialect, *fields),
        }
        yield Case(dialect, command, {}, facts)


class _Back(NamedTuple):
    """A way back to zero. `turns`: from the zero, counted clockwise where the direction decides, else as the encoder does."""

    mode: int
    direction: int
    speed: int
    turns: float


class _Came(NamedTuple):
    """What came of one. `wanted`: the way that it should take; `on_way`: the speed that the shaft had, where it was seen.

    `status`, `off`: what 3B said at the end, and by how many counts the shaft missed its zero.
    """

    back: _Back
    exchange: Exchange
    wanted: int
    on_way: float | None
    status: int
    off: int


_NEARER, _BY_DIRECTION, _CLOCKWISE, _COUNTER = 2, 1, 0, 1
#: By the shorter way though the direction says the other one; by the direction the longer way.
#: Each direction has the fastest way back, for which no other speed could be taken, and one of them the slowest too.
_BACKS = (
    _Back(_NEARER, _COUNTER, 0, 0.3),
    _Back(_BY_DIRECTION, _CLOCKWISE, 4, 0.3),
    _Back(_BY_DIRECTION, _COUNTER, 4, -0.3),
    _Back(_BY_DIRECTION, _COUNTER, 0, -0.3),
)
#: Between two looks at a shaft on its way back, and the speed of one that surely turns.
_ON_WAY_NS, _TURNS_RPM = 25 * MS, 10


@of_read_back(
    each=_zero_modes,
    name="{command}/restart",
    refuted_by="another place, another way, or another speed",
    at_best=Certainty.LIKELY,
)
def _returns_to_zero(probe: Probe, command: Command) -> None:
    """With a zero kept, the shaft goes back to it after a restart: the way that was set, and faster by a higher speed."""
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    clockwise = arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), -18)
    sense = 1 if clockwise.degrees > 0 else -1
    try:
        every = [_come_back(probe, command, back, sense) for back in _BACKS]
    finally:
        probe.do(command, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})
    for came in every:
        shown = f"zero_mode {came.back.mode}, zero_direction {came.back.direction}, {came.back.turns:+g} turns from the zero"
        # The drive takes the end of the way back for its zero, so that the angle within the turn is what shows it.
        probe.expect(
            f"{came.off} counts off, 3B {came.status}",
            holds=came.status == 1 and came.off <= _PLAY,
            expected=f"zero, and 3B 1: {shown}",
            refutes=f"the shaft is {came.off} counts off after a restart, and 3B says {came.status}",
            exchange=came.exchange,
            key="zero mode",
        )
        if came.on_way is not None:
            text = "the shaft goes the other way back to its zero"
            right = came.on_way * came.wanted > 0
            told = f"{came.on_way:+.3g} rpm"
            probe.expect(told, holds=right, expected=f"the other way: {shown}", refutes=text, exchange=came.exchange)
    speeds = sorted((came.back.speed, abs(came.on_way)) for came in every if came.on_way is not None)
    for (slow, rpm), (fast, more) in combinations(speeds, 2):
        if slow < fast:
            text = "a higher zero_speed does not bring the shaft back faster"
            expected = f"more than at {slow}: {rpm:.3g} rpm"
            probe.expect(f"{more:.3g} rpm at {fast}", holds=more > rpm, expected=expected, refutes=text)


def _come_back(probe: Probe, command: Command, back: _Back, sense: int) -> _Came:
    """Keep a zero, go away from it and restart. `sense`: 1 where clockwise raises the position."""
    turn = probe.dialect.counts_per_turn
    motion.ready_to_move(probe)
    by_direction = back.mode == _BY_DIRECTION
    values = {"zero_mode": back.mode, "set_zero": 1, "zero_speed": back.speed, "zero_direction": back.direction}
    probe.do(command, values)
    away = back.turns * (sense if by_direction else 1)
    setting_effects.shift(probe, Verb.MOVE_RELATIVE_AXIS, {"speed": 120, "acceleration": STEEP, "position": round(away * turn)})
    exchange = restart(probe, arrives=False)
    rpm = _on_its_way(probe)
    motion.wait_standing(probe)
    status, now = probe.read(Verb.READ_ZERO_STATUS), probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    wanted = sense * (1 if back.direction == _CLOCKWISE else -1) if by_direction else (-1 if away > 0 else 1)
    return _Came(back, exchange, wanted, rpm, status, min(now, turn - now))


def _on_its_way(probe: Probe) -> float | None:
    """Return the speed of a shaft that turns, None where it does not, or where its place jumps to zero at the end."""
    looks = [motion.position(probe)]
    for _ in range(2):
        probe.wait(_ON_WAY_NS)
        looks.append(motion.position(probe))
    (first, off), (second, off_too) = (motion.speed_between(one, other) for one, other in pairwise(looks))
    steady = abs(first - second) <= _SHARE * 3 * abs(first) + off + off_too and abs(first) > _TURNS_RPM
    return (first + second) / 2 if steady else None


@of_read_back(each=_zero_modes, name="{command}/clean", refuted_by="a shaft that goes back", at_best=Certainty.LIKELY)
def _returns_to_none(probe: Probe, command: Command) -> None:
    """With its zero cleaned the shaft stays where it is after a restart."""
    turn = probe.dialect.counts_per_turn
    values = {"zero_mode": 2, "zero_speed": 2, "zero_direction": 0}
    # A zero that was set by a command or kept before is forgotten: the angle counts from where that of after does.
    probe.do(command, {**values, "set_zero": 0})
    restart(probe)
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    probe.do(command, {**values, "set_zero": 1})
    setting_effects.shift(probe, Verb.MOVE_RELATIVE_AXIS, {"speed": 120, "acceleration": STEEP, "position": turn // 4})
    probe.do(command, {**values, "set_zero": 0})
    before = probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    exchange = restart(probe, arrives=False)
    # One that goes back is under way by then.
    probe.wait(400 * MS)
    motion.wait_standing(probe)
    now = probe.read(Verb.READ_ENCODER_CARRY, "encoder")
    probe.do(command, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})
    text = "the shaft goes back after a restart to a zero that was cleaned"
    probe.expect((now - before) % turn, holds=_apart(now, before, turn) <= _PLAY, expected="0", refutes=text, exchange=exchange)


def _apart(one: int, other: int, turn: int) -> int:
    return min((one - other) % turn, (other - one) % turn)


# --- motion after a restart ---------------------------------------------------------------------------------------------


def _restarts(dialect: Dialect) -> Iterator[Case]:
    if dialect.family == "mks":
        yield from commands(Verb.RESTART)(dialect)


def _turners(dialect: Dialect) -> list[Command]:
    """Return the setting of the motor's direction, where there is one."""
    return [command for command in dialect.commands if command.verb is Verb.SET_DIRECTION]


@of_read_back(
    each=_restarts,
    name="{command}/motion-as-before",
    refuted_by="another distance or speed, or the other way",
    risks=lambda case: (
        _restart_risks(case).union(*(c.all_risks for c in (*motion_commands(case.dialect), *_turners(case.dialect))))
        | motion.risks(case.dialect)
    ),
    settings=lambda case: motion.settings(case.dialect, *(("motor_direction",) if _turners(case.dialect) else ())),
    at_best=Certainty.LIKELY,
)
def _motion_as_before(probe: Probe, command: Command) -> None:
    """After a restart each motion is as far, as fast and the same way as before, by the stored mode, subdivision, direction."""
    motion.ready_to_move(probe, motion.bus_modes(probe.dialect)[0], subdivision=8)
    for turner in _turners(probe.dialect):
        probe.do(turner, {"motor_direction": 1})
    before = _each_motion(probe)
    motion.run_at(probe, _RPM, motion.QUICK)
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


def motion_commands(dialect: Dialect) -> tuple[Command, ...]:
    """Return the motions that a bus asks for."""
    return dialect.motions(*motion.RUNS_AND_MOVES)


def _each_motion(probe: Probe) -> dict[str, float]:
    """Return what each motion does: the degrees of a move, and the rpm of a run beyond what its mode can."""
    found = {}
    for command in motion_commands(probe.dialect):
        how = {"subdivision": 8, "acceleration": motion.QUICK}
        if command.motion is not None and command.motion.kind is MotionKind.RUN:
            # Beyond 400 rpm as sent, so that the limit of the mode shows too.
            motion.begin(probe, command, rpm=_BEYOND, **how)
            probe.wait(700 * MS)
            found[command.name] = motion.speed(probe).value
            motion.stand_still(probe)
        else:
            found[command.name] = arriving.follow(probe, command, 90, rpm=120, **how).degrees
    return found


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
