"""Restore (MKS): 3F puts every setting back to its default, address, speed and dialect too.

    restore/settings    each setting that can be seen is the default
    restore/link        the drive answers at the default address, in the default dialect

Rules kept here:
- A restore wipes the drive: these claims run only where they are named.
- The drive is led back to the speed, dialect and address at which it was found.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer import dialects as registry
from analyzer import layout
from analyzer.catalogue import Command, Dialect, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims import ranges, ranges_link, read_back
from conformance.claims.declare import declare
from conformance.claims.effects import Effect
from conformance.claims.known_quirks import known
from conformance.claims.read_back_restart import OTHER_ADDRESS, RESTORED_NS, kept_effect
from conformance.motion import motion, moves
from conformance.talk.acceptance import answers, need_reliable_replies
from conformance.talk.probe import Probe

_DEFAULT_ADDRESS = 1


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about a restore."""
    if moves.is_mks(dialect):
        yield _restore(dialect)
        yield _restored_link(dialect)


def defaults(field: Field) -> set[int]:
    """Return the values that a field may have by default: of its model, or of all where that is not known."""
    if field.default is not None:
        return {int(field.default)}
    return {limit.default for limit in (field.models or {}).values() if limit.default is not None}


def _settings(dialect: Dialect) -> list[tuple[Command, Effect]]:
    found = [(c, kept_effect(dialect, c)) for c in dialect.commands if c.verb is not Verb.SET_GROUP_ADDRESS]
    return [(c, e) for c, e in found if e is not None]


def _restore(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.RESTORE]
    settings = _settings(dialect)
    risks = set(command.all_risks) | {Risk.SETTING}
    for each, effect in settings:
        one, _ = effect.pair(each.request_forms[0])
        seen = each.readable or effect.expected is not None
        risks |= ranges.needs(dialect, each, [one])["risks"] | (effect.risks(dialect) if seen else motion.risks(dialect))

    def check(probe: Probe) -> None:
        for each, effect in settings:
            effect.ready(probe)
            ranges.prepare(probe, each)
        for each, effect in settings:
            form = each.request_forms[0]
            probe.do(each, ranges.plain(probe, each, form, **effect.pair(form)[0]))
        exchange = probe.do(command)
        lead_back(probe)
        if not answers(probe, probe.address):
            raise Inconclusive("the restored drive cannot be reached as it is said to be by default")
        for each, effect in settings:
            _is_default(probe, each, effect, exchange)

    return declare(
        dialect, Theme.READ_BACK, "restore/settings", "A restore puts every setting back to its default.",
        "a setting that is as it was", check, command=command, aspect=Aspect.STATE, risks=risks, by_name=True, alone=True,
    )  # fmt: skip


def lead_back(probe: Probe) -> None:
    """Wait for a restored drive and lead it from the default speed, dialect and address back to those of this probe.

    Raises NotRun where this end cannot change its speed.
    """
    dialect = probe.dialect
    before, usual = probe.gate.line.endpoint.bits_per_second, dialect.baud_rates[0]
    if before != usual:
        ranges_link.follow(probe, usual)
    probe.wait(RESTORED_NS)
    chooser = dialect.effect(layout.Effect.DIALECT)
    if chooser is not None:
        command, field = chooser
        spoken = {field.name: dialect.chosen_by}
        ranges_link.foreign(probe, _restored_dialect(dialect), command.name, spoken, address=_DEFAULT_ADDRESS)
    if probe.address != _DEFAULT_ADDRESS:
        probe.ask(Verb.SET_ADDRESS, {"new_address": probe.address}, address=_DEFAULT_ADDRESS)
        probe.wait(ranges_link.SETTLE_NS)
    if before != usual:
        ranges_link.set_speed(probe, before)
        ranges_link.follow(probe, before)
        probe.wait(ranges_link.SETTLE_NS)


def _restored_dialect(dialect: Dialect) -> Dialect:
    """Return the dialect that a restored drive speaks."""
    chooser = dialect.effect(layout.Effect.DIALECT)
    if chooser is None:
        return dialect
    spoken = dialect.switched(int(chooser[1].default or 0))
    return dialect if spoken == dialect.name else registry.get(spoken)


def _is_default(probe: Probe, command: Command, effect: Effect, exchange: Any) -> None:
    form = command.request_forms[0]
    if command.readable:
        got, _ = read_back.stored(probe, command)
        for name, value in got.items():
            wanted = defaults(form.layout.named[name])
            if wanted and value not in wanted:
                expected = " or ".join(map(str, sorted(wanted)))
                raise Refuted(
                    f"{command.name}: {name} is {value} after a restore", expected=expected, got=str(value), exchange=exchange,
                    key=f"{command.name} restore",
                )  # fmt: skip
        return
    wanted_values = {n: min(d) for n, f in form.layout.named.items() if (d := defaults(f))}
    if effect.expected is None or wanted_values.keys() != form.layout.named.keys():
        return
    if command.verb is not Verb.SET_WORK_MODE:
        effect.ready(probe)
    seen, should = effect.see(probe), effect.expected(probe.dialect, wanted_values)
    if not effect.same(should, seen):
        raise Refuted(
            f"{command.name} after a restore: {effect.words(seen)}", expected=effect.words(should), got=effect.words(seen),
            exchange=exchange, key=f"{command.name} restore",
        )  # fmt: skip


def _restored_link(dialect: Dialect) -> Claim:
    """Make the claim that a restore puts back the address, and the dialect that the drive speaks."""
    command = dialect.by_verb[Verb.RESTORE]
    setter = dialect.by_verb[Verb.SET_ADDRESS]
    native = _restored_dialect(dialect)

    def check(probe: Probe) -> None:
        need_reliable_replies(probe)
        ranges_link.readdress(probe, setter, OTHER_ADDRESS)
        if not answers(probe, OTHER_ADDRESS):
            raise Inconclusive(f"the drive does not answer at {OTHER_ADDRESS}, which it was given")
        exchange = probe.ask(command, address=OTHER_ADDRESS)
        probe.wait(RESTORED_NS)
        if dialect is native:
            found = [a for a in (_DEFAULT_ADDRESS, OTHER_ADDRESS) if answers(probe, a)]
        else:
            found = [a for a in (_DEFAULT_ADDRESS, OTHER_ADDRESS) if _answers_in(probe, native, a)]
        lead_back(probe)
        if found != [_DEFAULT_ADDRESS]:
            places = " and ".join(map(str, found)) or "neither address"
            raise Refuted(
                f"a restored drive answers at {places} in {native.name}",
                expected=f"an answer at {_DEFAULT_ADDRESS} in {native.name}", got=places, exchange=exchange, key="restore link",
            )  # fmt: skip

    return declare(
        dialect, Theme.READ_BACK, "restore/link", f"A restored drive answers at {_DEFAULT_ADDRESS} in {native.name}.",
        "an answer at the old address or in another dialect", check, command=command, aspect=Aspect.STATE, by_name=True,
        alone=True, risks=command.all_risks | setter.all_risks, quirks=known(dialect, ranges_link.NEW_ADDRESS_ANSWERS),
    )  # fmt: skip


def _answers_in(probe: Probe, dialect: Dialect, address: int) -> bool:
    answer = ranges_link.foreign(probe, dialect, "read_speed", address=address)
    ranges_link.readable(dialect, address, answer)
    return ranges_link.whole(dialect, address, answer)
