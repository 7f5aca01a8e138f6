"""Restore (MKS): 3F puts every setting back to its default, address, speed and dialect too.

    restore/settings    each setting that can be read, or whose effect is known, is the default
    restore/SETTING     one without a printed default is not what was set
    restore/FIELD       a field that shows in what the drive does, some with hands, is the default
    restore/link        the drive answers at the default address, in the default dialect

Rules kept here:
- A restore wipes the drive: these claims run only where they are named.
- The drive is led back to the speed, dialect and address at which it was found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.layout import Effect, Field
from conformance.claim import Inconclusive
from conformance.claims.addressing import ways
from conformance.claims.declare import Case
from conformance.claims.known_quirks import may_meet
from conformance.claims.ranges import edges
from conformance.claims.settings import kept_effects, read_back
from conformance.claims.settings.kept_effects import Kept
from conformance.claims.settings.link_changes import (
    NEW_ADDRESS_ANSWERS,
    SETTLE_NS,
    ask_in,
    follow,
    is_reply,
    need_reply_or_silence,
    other_address,
    set_rate,
)
from conformance.claims.settings.read_back import of_read_back
from conformance.claims.settings.restart import RESTORED_NS, move_away, stored_effect
from conformance.claims.settings.setting_effects import SettingEffect, differing
from conformance.motion import arriving, declared, effects, motion
from conformance.motion.declared import SUBDIVISION
from conformance.motion.effects import Observable
from conformance.talk import settings
from conformance.talk.acceptance import answers
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe
from conformance.talk.restarts import restart

_DEFAULT_ADDRESS = 1


def _native(dialect: Dialect) -> Dialect:
    """Return the dialect that a restored drive speaks: the one whose value of the dialect setting is the default."""
    found = dialect.effect(Effect.DIALECT)
    if found is None or found[1].default == dialect.chosen_by:
        return dialect
    return registry.get(dialect.siblings[0])


def _settings(dialect: Dialect) -> list[tuple[Command, SettingEffect]]:
    grouping = {command.name for command, _ in dialect.effects(Effect.GROUP)}
    found = [(c, stored_effect(dialect, c)) for c in dialect.commands if c.name not in grouping]
    return [(c, e) for c, e in found if e is not None]


# --- settings ---------------------------------------------------------------------------------------------------------


def _restores(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.RESTORE)
    if command is not None:
        risks = set(command.all_risks) | {Risk.SETTING}
        for each, effect in _settings(dialect):
            one, _ = effect.pair(each.request_forms[0])
            seen = each.readable or effect.expected is not None
            risks |= edges.needs(dialect, each, [one])["risks"] | (effect.risks(dialect) if seen else declared.risks(dialect))
        yield Case(dialect, command, {}, {"risks": risks})


@of_read_back(each=_restores, name="{command}/settings", refuted_by="a setting that is as it was", by_name=True, alone=True)
def _restored(probe: Probe, command: Command) -> None:
    """A restore puts every setting back to its default."""
    every = _settings(probe.dialect)
    for each, effect in every:
        effect.ready(probe)
        edges.prepare(probe, each)
    for each, effect in every:
        form = each.request_forms[0]
        probe.do(each, edges.plain(probe, each, form, **effect.pair(form)[0]))
    exchange = probe.do(command)
    _lead_back(probe)
    if not answers(probe, probe.address):
        raise Inconclusive("the restored drive cannot be reached as it is said to be by default")
    for each, effect in every:
        if each.readable:
            _expect_default_read(probe, each, exchange)
        else:
            _expect_default_seen(probe, each, effect, exchange)


def _lead_back(probe: Probe) -> None:
    """Wait for a restored drive and lead it from the default speed, dialect and address back to those of this probe.

    Raises NotRun where this end cannot change its speed.
    """
    dialect = probe.dialect
    before, usual = probe.gate.line.endpoint.bits_per_second, dialect.baud_rates[0]
    if before != usual:
        follow(probe, usual)
    probe.wait(RESTORED_NS)
    found = dialect.effect(Effect.DIALECT)
    if found is not None and dialect.chosen_by is not None:
        ask_in(probe, _native(dialect), found[0].name, {found[1].name: dialect.chosen_by}, address=_DEFAULT_ADDRESS)
        probe.wait(probe.rig.write_gap_ns)
    setter = dialect.effect(Effect.ADDRESS)
    if setter is not None and probe.address != _DEFAULT_ADDRESS:
        probe.ask(setter[0], {setter[1].name: probe.address}, address=_DEFAULT_ADDRESS)
        probe.wait(SETTLE_NS)
    if before != usual:
        set_rate(probe, before)
        follow(probe, before)
        probe.wait(SETTLE_NS)


def _defaults(field: Field) -> set[int]:
    """Return the values that a field may have by default: of its model, or of all where that is not known."""
    if field.default is not None:
        return {int(field.default)}
    return {limit.default for limit in (field.models or {}).values() if limit.default is not None}


def _expect_default_read(probe: Probe, command: Command, exchange: Exchange) -> None:
    got, _ = read_back.stored(probe, command)
    for name, value in got.items():
        wanted = _defaults(command.request_forms[0].layout.named[name])
        probe.expect(
            value,
            holds=not wanted or value in wanted,
            expected=" or ".join(map(str, sorted(wanted))),
            refutes=f"{command.name}: {name} is {value} after a restore",
            exchange=exchange,
            key=f"{command.name} restore",
        )


def _expect_default_seen(probe: Probe, command: Command, effect: SettingEffect, exchange: Exchange) -> None:
    named = command.request_forms[0].layout.named
    wanted = {n: min(d) for n, f in named.items() if (d := _defaults(f))}
    if effect.expected is None or wanted.keys() != named.keys():
        return
    if command.verb is not Verb.SET_WORK_MODE:
        effect.ready(probe)
    seen, should = effect.see(probe), effect.expected(probe.dialect, wanted)
    text = f"{command.name} after a restore: {effect.words(seen)}"
    effect.expect(probe, seen, should, text, exchange, f"{command.name} restore")


# --- settings whose default no manual prints --------------------------------------------------------------------------


def _unprinted(dialect: Dialect) -> Iterator[Case]:
    restores = dialect.by_verb.get(Verb.RESTORE)
    for command in dialect.commands:
        named = command.request_forms[0].layout.named.values() if command.readable else ()
        if restores and named and not any(map(_defaults, named)) and not settings.changes_link(command):
            values = differing(command.request_forms[0])
            needs = edges.needs(dialect, command, values)
            facts = {"risks": needs["risks"] | restores.all_risks, "settings": needs["settings"], "parameters": {}}
            yield Case(dialect, restores, {"setter": command, "values": values}, facts)


@of_read_back(
    each=_unprinted,
    name="{command}/{setter}",
    refuted_by="a setting that is as it was each time",
    by_name=True,
    alone=True,
    at_best=Certainty.LIKELY,
)
def _forgets(probe: Probe, command: Command, setter: Command, values: Sequence[Mapping[str, int]]) -> None:
    """A restore brings {setter} to one value from each that was set before."""
    kept = []
    for given in values:
        probe.do(setter, given)
        exchange = _restore(probe, command)
        kept.append(read_back.stored(probe, setter)[0] == given)
    text = f"{setter.name} is as it was set, after a restore"
    probe.expect(kept, holds=not all(kept), expected="another value", refutes=text, exchange=exchange)


# --- field by field ---------------------------------------------------------------------------------------------------


def _restored_fields(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.RESTORE)
    if command is not None:
        for setter, row in kept_effects.rows(dialect):
            needs = edges.needs(dialect, setter, [row.values])
            facts = row.effect.needed(dialect, needs, *command.all_risks, *declared.risks(dialect))
            facts |= {"parameters": {"field": row.name}, "emulated": row.hands, "by_name": True, "alone": True}
            yield Case(dialect, command, {"setter": setter, "row": row}, facts)


@of_read_back(each=_restored_fields, name="{command}/{row}", refuted_by="a setting that is as it was")
def _restored_field(probe: Probe, command: Command, setter: Command, row: Kept) -> None:
    """A restore puts {row} back to its default."""
    _restore(probe, command)
    row.effect.ready(probe)
    default = row.effect.see(probe)
    probe.do(setter, edges.plain(probe, setter, setter.request_forms[0], **row.values))
    kept_effects.need_difference(probe, row, row.effect.see(probe), default)
    exchange = _restore(probe, command)
    row.effect.ready(probe)
    seen = row.effect.see(probe)
    row.effect.expect(probe, seen, default, f"{row.name} is not the default after a restore", exchange)


def _restore(probe: Probe, command: Command) -> Exchange:
    """Restore the drive and lead it back. Raises Inconclusive where it cannot be reached then."""
    exchange = probe.do(command)
    _lead_back(probe)
    if not answers(probe, probe.address):
        raise Inconclusive("the restored drive cannot be reached as it is said to be by default")
    return exchange


def _kept_for_power_on(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.RESTORE)
    for verb, values in ((Verb.SAVE_SPEED, _KEEP_RUN), (Verb.SET_ZERO_MODE, _KEEP_ZERO)):
        keeper = dialect.by_verb.get(verb)
        if command is not None and keeper is not None:
            risks = declared.risks(dialect, Risk.UNBOUNDED, *command.all_risks, *keeper.risks(values))
            yield Case(dialect, command, {"keeper": keeper, "values": values}, {"risks": risks, "parameters": {}})


#: What makes a drive keep its run, and its zero, for power-on.
_KEEP_RUN = {"save_state": 0xC8}
_KEEP_ZERO = {"zero_mode": 2, "set_zero": 1, "zero_speed": 2, "zero_direction": 0}


@of_read_back(each=_kept_for_power_on, name="{command}/{keeper}", refuted_by="a shaft that turns", by_name=True, alone=True)
def _restored_power_on(probe: Probe, command: Command, keeper: Command, values: dict[str, int]) -> None:
    """A restored drive has forgotten what {keeper} kept: its shaft stands, then and after a restart."""
    _restore(probe, command)
    known = Verb.READ_ZERO_STATUS in probe.dialect.by_verb
    status = probe.read(Verb.READ_ZERO_STATUS, "status") if known else 0
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    if keeper.verb is Verb.SAVE_SPEED:
        motion.run_at(probe, -60)
    probe.do(keeper, values)
    motion.stand_still(probe)
    arriving.follow(probe, declared.any_move(probe.dialect), 75)
    before = motion.position(probe)
    exchange = _restore(probe, command)
    for when in ("after a restore", "after a restart behind a restore"):
        probe.wait(SETTLE_NS)
        at = motion.position(probe)
        probe.wait(SETTLE_NS)
        moved, turning = motion.position(probe).value - at.value, motion.turning(probe)
        # What was kept may have been carried out before the shaft could be looked at; whole turns are not kept.
        away = (at.value - before.value + 180) % 360 - 180
        motion.ready_to_move(probe)
        motion.stand_still(probe)
        text = f"the shaft turns {when}, as {keeper.name} had it kept"
        for value, unit in ((turning.value, "rpm"), (moved, "degrees"), (away, "degrees")):
            probe.expect(value, near=0, within=1, unit=unit, refutes=text, exchange=exchange)
        if known:
            text = f"3B reads something else {when} than before"
            probe.expect(probe.read(Verb.READ_ZERO_STATUS, "status"), equal=status, refutes=text, exchange=exchange)
        restart(probe)


# --- starting again ---------------------------------------------------------------------------------------------------


def _restored_on_the_way(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.RESTORE)
    if command is not None:
        yield Case(dialect, command, {}, {"parameters": {}, "risks": declared.risks(dialect, *command.all_risks)})


@of_read_back(each=_restored_on_the_way, refuted_by="a shaft that turns on", by_name=True, alone=True, at_best=Certainty.LIKELY)
def _reboots(probe: Probe, command: Command) -> None:
    """A restored drive starts again, and that ends a motion."""
    move = declared.any_move(probe.dialect)
    motion.prepare(probe, move)
    motion.begin(probe, move, _LONG_TURNS * 360)
    probe.wait(SETTLE_NS)
    if abs(motion.turning(probe).value) < 1:
        raise Inconclusive("the shaft does not turn before the restore")
    exchange = probe.do(command)
    _lead_back(probe)
    turning = motion.turning(probe)
    motion.wait_standing(probe)
    text = "a restored drive goes on turning its shaft"
    probe.expect(turning, near=0, within=1, unit="rpm", refutes=text, exchange=exchange)


#: A move at 60 rpm that goes on for longer than a restored drive takes to come back.
_LONG_TURNS = 12

# --- the link ---------------------------------------------------------------------------------------------------------


def _restored_links(dialect: Dialect) -> Iterator[Case]:
    command, setter = dialect.by_verb.get(Verb.RESTORE), dialect.effect(Effect.ADDRESS)
    if command is not None and setter is not None:
        given = {"native": _native(dialect), "setter": setter[0], "address": _DEFAULT_ADDRESS}
        shown, risks = _shown_by_a_group(dialect), command.all_risks | setter[0].all_risks
        facts: dict[str, Any] = {"parameters": {}, "risks": risks}
        if shown is not None:
            group = dialect.by_verb[Verb.SET_GROUP_ADDRESS]
            facts |= {"risks": risks | shown.risks | group.all_risks, "settings": (*shown.settings, "group_address")}
        yield Case(dialect, command, given, facts)


def _shown_by_a_group(dialect: Dialect) -> Observable | None:
    """Return what shows that a group is heard, of a dialect that has groups."""
    return effects.observable(dialect) if Verb.SET_GROUP_ADDRESS in dialect.by_verb else None


@of_read_back(
    each=_restored_links,
    refuted_by="an answer at the old address or in another dialect",
    by_name=True,
    alone=True,
    quirks=may_meet(NEW_ADDRESS_ANSWERS),
)
def _link(probe: Probe, command: Command, native: Dialect, setter: Command) -> None:
    """A restored drive answers at {address} in {native}, and is in no group."""
    shown = _shown_by_a_group(probe.dialect)
    if shown is not None:
        shown.prepare(probe)
        group = ways.join(probe)
    move_away(probe, setter)
    away = other_address(probe.dialect)
    exchange = probe.ask(command, address=away)
    probe.wait(RESTORED_NS)
    found = [a for a in (_DEFAULT_ADDRESS, away) if _answers_in(probe, native, a)]
    _lead_back(probe)
    places = " and ".join(map(str, found)) or "neither address"
    probe.expect(
        places,
        holds=found == [_DEFAULT_ADDRESS],
        expected=f"an answer at {_DEFAULT_ADDRESS} in {native.name}",
        refutes=f"a restored drive answers at {places} in {native.name}",
        exchange=exchange,
        key="restore link",
    )
    if shown is not None:
        shown.prepare(probe)
        change = shown.change(probe)
        sent = ways.send_to(probe, group, change, shown.settle_ns)
        text = f"a restored drive is in the group {group} still"
        holds, expected = not shown.done(probe, change), "no effect of what the group is told"
        probe.expect("its effect", holds=holds, expected=expected, refutes=text, exchange=sent)
        shown.control(probe)


def _answers_in(probe: Probe, dialect: Dialect, address: int) -> bool:
    if dialect.name == probe.dialect.name:
        return answers(probe, address)
    answer = ask_in(probe, dialect, "read_speed", address=address)
    need_reply_or_silence(dialect, address, answer)
    return is_reply(dialect, address, answer)
