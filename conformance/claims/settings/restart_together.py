"""Restart: a drive keeps every setting, all of them at once, however they were sent.

    settings/restart              sent to the drive itself
    settings/restart-broadcast    to all drives
    settings/restart-group        to its group
    settings/restart-package      in a slot of a package
    SETTING/restart-group-FIELD   a field of it that shows by hands on an emulated drive, and so for all ways but the first
    save_speed/broadcast, ...     a run that is kept so, and forgotten and restarted in the next ways, one after the other

Rules kept here:
- What the drive is told by one of the latter is not answered, so that only what is there after a restart tells.
- So sent are a few settings that show soon: each takes the time of a flash, when it is set and when it is put back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle, islice

from analyzer.catalogue import Command, Dialect, Doubt, Risk, Verb
from conformance.claims.addressing import package, ways
from conformance.claims.control_reads import expect_silence
from conformance.claims.declare import Case
from conformance.claims.ranges import edges
from conformance.claims.settings import kept_effects
from conformance.claims.settings.effects_together import SILENT_NS, expect_effects
from conformance.claims.settings.kept_effects import Kept
from conformance.claims.settings.known_settings import ReadableSetting, Setting, every_setting, needs
from conformance.claims.settings.read_back import fields_of, of_read_back
from conformance.motion import declared, motion
from conformance.motion.declared import SUBDIVISION
from conformance.motion.effects import Change
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe
from conformance.talk.restarts import need_axis_lock, restart, wait_for_answer


@dataclass(frozen=True)
class _Way:
    """How settings are sent. `heard`: whether a dialect has it; `ready`: what it needs, and changes `settings`."""

    kind: str
    how: str
    send: Callable[[Probe, Command, Mapping[str, int]], Exchange]
    heard: Callable[[Dialect], bool] = lambda dialect: True
    ready: Callable[[Probe], object] = lambda probe: None
    settings: tuple[str, ...] = ()

    def risks(self, dialect: Dialect) -> frozenset[Risk]:
        """Return what `ready` risks."""
        return dialect.by_verb[Verb.SET_GROUP_ADDRESS].all_risks if self.ready is ways.join else frozenset()

    def chosen(self, dialect: Dialect) -> list[Setting]:
        """Return the settings of a dialect that are sent so."""
        every = [each for each in every_setting(dialect) if each.command.verb is not Verb.SET_ENABLE_LEVEL]
        soon = (each for each in every if each.command.verb in _SHOWN or (each.command.verb in _READ and each.command.readable))
        return every if self.send is _to_itself else list(soon)


def _to_itself(probe: Probe, command: Command, values: Mapping[str, int]) -> Exchange:
    return probe.do(command, values)


def _to_all(probe: Probe, command: Command, values: Mapping[str, int]) -> Exchange:
    assert probe.dialect.broadcast is not None  # `heard` asks for it
    return _to(probe, probe.dialect.broadcast, command, values)


def _to(probe: Probe, address: int, command: Command, values: Mapping[str, int]) -> Exchange:
    return ways.send_to(probe, address, Change(command, dict(values), 0, 0), SILENT_NS)


def _in_slot(probe: Probe, command: Command, values: Mapping[str, int]) -> Exchange:
    return probe.send(package.in_own_slot(probe, command, values), timeout_ns=max(SILENT_NS, probe.rig.silence_ns))


#: What shows by a move, a run and homing; what shows where it can be read.
_SHOWN, _READ = {Verb.SET_SUBDIVISION, Verb.SET_RESPOND, Verb.SET_HOME}, {Verb.SET_WORK_MODE, Verb.SET_CURRENT}
_WAYS = (
    _Way("restart", "to the drive", _to_itself),
    _Way("restart-broadcast", "to all drives", _to_all, lambda dialect: dialect.broadcast is not None),
    _Way(
        "restart-group",
        "to the group",
        lambda probe, command, values: _to(probe, ways.group_of(probe.dialect, probe.address), command, values),
        lambda dialect: Verb.SET_GROUP_ADDRESS in dialect.by_verb,
        ways.join,
        ("group_address",),
    ),
    _Way("restart-package", "in a slot of a package", _in_slot, lambda dialect: bool(package.of(dialect))),
)


def _all_together(dialect: Dialect) -> Iterator[Case]:
    if Verb.RESTART not in dialect.by_verb or not declared.can_move(dialect):
        return
    for way in _WAYS:
        if not way.heard(dialect):
            continue
        chosen = way.chosen(dialect)
        risks, names = needs(chosen)
        joining = way.risks(dialect)
        facts = {
            "section": dialect.by_verb[Verb.RESTART].section,
            "risks": declared.risks(dialect, Risk.UNBOUNDED, *risks, *dialect.by_verb[Verb.RESTART].all_risks, *joining),
            "settings": tuple(dict.fromkeys((*declared.settings(dialect, *names), *way.settings))),
            "commands": tuple(each.command.name for each in chosen),
            "alone": way is not _WAYS[0],
            "parameters": {},
        }
        yield Case(dialect, given={"chosen": chosen, "way": way, "kind": way.kind, "how": way.how}, facts=facts)


@of_read_back(each=_all_together, name="settings/{kind}", refuted_by="another setting", aspect=None)
def _all_kept(probe: Probe, chosen: list[Setting], way: _Way) -> None:
    """A restart keeps every setting that was sent {how}, at any values of the others."""
    motion.ready_to_move(probe)
    way.ready(probe)
    held: dict[str, Mapping[str, int]] = {}
    # What some modes refuse is set before the mode.
    for each in sorted(chosen, key=lambda each: each.command.verb is Verb.SET_WORK_MODE):
        values = each.other(each.read(probe)) if isinstance(each, ReadableSetting) else each.values[0]
        exchange = way.send(probe, each.command, values)
        if way.send is not _to_itself:
            expect_silence(probe, exchange, f"{each.name}, sent {way.how}, is answered")
        held[each.name] = values
    restart(probe)
    for each in chosen:
        if isinstance(each, ReadableSetting):
            got = each.read(probe)
            text = f"{each.name}, sent {way.how}, is another one after a restart"
            wanted = {n: held[each.name][n] for n in got if n in held[each.name]}
            probe.expect({n: got[n] for n in wanted}, equal=wanted, refutes=text, exchange=exchange, key=f"{each.name} lost")
    expect_effects(probe, chosen, held, f"{way.how} before a restart")


def _fields_with_hands(dialect: Dialect) -> Iterator[Case]:
    """Yield each way to several drives with the stored fields that show by hands alone."""
    for way in _WAYS[1:] if Verb.RESTART in dialect.by_verb else ():
        for command, row in kept_effects.rows(dialect) if way.heard(dialect) else ():
            if row.hands:
                risks = (*dialect.by_verb[Verb.RESTART].all_risks, *way.risks(dialect), *declared.risks(dialect))
                facts = row.effect.needed(dialect, edges.needs(dialect, command, [row.values]), *risks)
                facts |= {"parameters": {"field": row.name}, "emulated": True, "alone": True}
                facts["settings"] = (*facts["settings"], *way.settings)
                yield Case(dialect, command, {"row": row, "way": way, "kind": way.kind, "how": way.how}, facts)


@of_read_back(
    each=_fields_with_hands,
    name="{command}/{kind}-{row}",
    refuted_by="another setting",
    fields=fields_of,
    rests_on=(Doubt.ADDRESSING,),
)
def _kept_field(probe: Probe, command: Command, row: Kept, way: _Way) -> None:
    """A restart keeps {row}, as {command} set it {how}."""
    motion.ready_to_move(probe)
    way.ready(probe)
    row.effect.ready(probe)
    default, values = row.effect.see(probe), edges.plain(probe, command, command.request_forms[0], **row.values)
    exchange = way.send(probe, command, values)
    expect_silence(probe, exchange, f"{command.name} {way.how} is answered")
    restart(probe)
    row.effect.ready(probe)
    seen = row.effect.see(probe)
    probe.do(command, values)
    should = row.effect.see(probe)
    kept_effects.need_difference(probe, row, should, default)
    text = f"{row.name} that was set {way.how} is another one after a restart"
    row.effect.expect(probe, seen, should, text, exchange)


#: The speed of a run that is kept, the other way of another one; how long a shaft has to get there.
_RPM, _SETS_OFF_NS = 30, 150 * MS
_KEEP, _FORGET = {"save_state": 0xC8}, {"save_state": 0xCA}


def _saved(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.SAVE_SPEED)
    if command is None or not declared.can_move(dialect):
        return
    heard = [way for way in _WAYS[1:] if way.heard(dialect)]
    for number in range(len(heard)):
        # Each way keeps, restarts and forgets in one of the claims.
        ways = tuple(islice(cycle(heard), number, number + 4))
        risks = command.all_risks.union(dialect.by_verb[Verb.RESTART].all_risks, *(way.risks(dialect) for way in ways))
        facts = {
            "fields": ("save_state",),
            "risks": declared.risks(dialect, Risk.UNBOUNDED, *risks - {Risk.UNKNOWN}),
            "settings": (*declared.settings(dialect), *(name for way in heard for name in way.settings)),
            "alone": True,
            "parameters": {},
        }
        how = {deed: way.how for deed, way in zip(("keeps", "restarts", "forgets"), ways, strict=False)}
        yield Case(dialect, command, {"ways": ways, "kind": ways[0].kind.removeprefix("restart-"), **how}, facts)


@of_read_back(each=_saved, name="{command}/{kind}", refuted_by="another run, or none", rests_on=(Doubt.VALUES,))
def _kept_run(probe: Probe, command: Command, ways: tuple[_Way, ...]) -> None:
    """{command} sent {keeps} keeps a run over a restart sent {restarts}, and sent {forgets} forgets it."""
    need_axis_lock(probe)
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    for way in ways[:-1]:
        way.ready(probe)
    keeps, restarts, forgets, restarts_again = ways
    motion.run_at(probe, _RPM)
    keeps.send(probe, command, _KEEP)
    # Which way a positive speed turns the manual does not say for sure.
    sense = 1 if motion.turning(probe).value > 0 else -1
    motion.run_at(probe, -_RPM)
    kept, *sent = _after_restart(probe, restarts, _RPM / 2)
    kept *= sense
    forgotten = 0.0
    if kept > _RPM / 2:
        forgets.send(probe, command, _FORGET)
        forgotten, again = _after_restart(probe, restarts_again)
        sent.append(again)
    probe.ask(command, _FORGET)
    motion.stand_still(probe)
    got = f"{kept:+g} rpm, and {forgotten:+g} rpm once it was forgotten"
    text = f"{command.name} {keeps.how} and a restart {restarts.how} do not keep a run, or the next ways do not forget it"
    holds = kept > _RPM / 2 and abs(forgotten) <= 1 + probe.noise.rpm
    probe.expect(got, holds=holds, expected=f"{_RPM:+g} rpm, and then a shaft that stands", refutes=text, exchange=sent[-1])
    for exchange in sent:
        expect_silence(probe, exchange, "a restart is answered that is not sent to the drive alone")


def _after_restart(probe: Probe, way: _Way, rpm: float = math.inf) -> tuple[float, Exchange]:
    """Restart a drive whose shaft turns; return how fast it turns then, and the restart. No more is waited for at `rpm`."""
    sent = way.send(probe, probe.command(Verb.RESTART), {})
    wait_for_answer(probe)
    motion.wait_until(probe, lambda: abs(motion.speed(probe).value) > rpm, limit_ns=_SETS_OFF_NS)
    return motion.speed(probe).value, sent
