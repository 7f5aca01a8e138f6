"""Restart: a drive keeps every setting, all of them at once, however they were sent.

    settings/restart              sent to the drive itself
    settings/restart-broadcast    to all drives
    settings/restart-group        to its group
    settings/restart-package      in a slot of a package

Rules kept here:
- What the drive is told by one of the latter is not answered, so that only what is there after a restart tells.
- So sent are a few settings that show soon: each takes the time of a flash, when it is set and when it is put back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from analyzer.catalogue import Dialect, Risk, Verb
from conformance.claims.addressing import many, package
from conformance.claims.declare import Case
from conformance.claims.resilience.settings import expect_effects
from conformance.claims.settings.known_settings import ReadableSetting, Setting, every_setting, needs
from conformance.claims.settings.read_back import of_read_back
from conformance.motion import motion
from conformance.motion.effects import Change
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe
from conformance.talk.restarts import restart

#: How long a setting that is not answered is given.
_SILENT_NS = 60 * motion.MS


@dataclass(frozen=True)
class _Way:
    """How settings are sent. `heard`: whether a dialect has it; `ready`: what it needs, and changes `settings`."""

    kind: str
    how: str
    send: Callable[[Probe, Setting, Mapping[str, int]], Exchange]
    heard: Callable[[Dialect], bool] = lambda dialect: True
    ready: Callable[[Probe], object] = lambda probe: None
    settings: tuple[str, ...] = ()

    def chosen(self, dialect: Dialect) -> list[Setting]:
        """Return the settings of a dialect that are sent so."""
        every = [each for each in every_setting(dialect) if each.command.verb is not Verb.SET_ENABLE_LEVEL]
        soon = (each for each in every if each.command.verb in _SHOWN or (each.command.verb in _READ and each.command.readable))
        return every if self.send is _to_itself else list(soon)


def _to_itself(probe: Probe, setting: Setting, values: Mapping[str, int]) -> Exchange:
    return probe.do(setting.command, values)


def _to_all(probe: Probe, setting: Setting, values: Mapping[str, int]) -> Exchange:
    assert probe.dialect.broadcast is not None  # `heard` asks for it
    return _to(probe, probe.dialect.broadcast, setting, values)


def _to_group(probe: Probe, setting: Setting, values: Mapping[str, int]) -> Exchange:
    return _to(probe, many.group_of(probe.dialect, probe.address), setting, values)


def _to(probe: Probe, address: int, setting: Setting, values: Mapping[str, int]) -> Exchange:
    return many.send_to(probe, address, Change(setting.command, dict(values), 0, 0), _SILENT_NS)


def _in_slot(probe: Probe, setting: Setting, values: Mapping[str, int]) -> Exchange:
    command = next(c for c in probe.dialect.commands if c.slots is not None)
    return package.in_second_slot(probe, command, setting.command.name, dict(values))


#: What shows by a move and a run; what shows where it can be read.
_SHOWN, _READ = {Verb.SET_SUBDIVISION, Verb.SET_RESPOND}, {Verb.SET_WORK_MODE, Verb.SET_CURRENT}
_WAYS = (
    _Way("restart", "to the drive", _to_itself),
    _Way("restart-broadcast", "to all drives", _to_all, lambda dialect: dialect.broadcast is not None),
    _Way(
        "restart-group",
        "to the group",
        _to_group,
        lambda dialect: Verb.SET_GROUP_ADDRESS in dialect.by_verb,
        many.join,
        ("group_address",),
    ),
    _Way(
        "restart-package",
        "in a slot of a package",
        _in_slot,
        lambda dialect: any(command.slots is not None for command in dialect.commands),
    ),
)


def _all_together(dialect: Dialect) -> Iterator[Case]:
    if Verb.RESTART not in dialect.by_verb or not motion.can_move(dialect):
        return
    for way in _WAYS:
        if not way.heard(dialect):
            continue
        chosen = way.chosen(dialect)
        risks, names = needs(chosen)
        joining = dialect.by_verb[Verb.SET_GROUP_ADDRESS].all_risks if way.ready is many.join else ()
        facts = {
            "section": dialect.by_verb[Verb.RESTART].section,
            "risks": motion.risks(dialect, Risk.UNBOUNDED, *risks, *dialect.by_verb[Verb.RESTART].all_risks, *joining),
            "settings": tuple(dict.fromkeys((*motion.settings(dialect, *names), *way.settings))),
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
        exchange = way.send(probe, each, values)
        held[each.name] = values
    restart(probe)
    for each in chosen:
        if isinstance(each, ReadableSetting):
            got = each.read(probe)
            text = f"{each.name}, sent {way.how}, is another one after a restart"
            wanted = {n: held[each.name][n] for n in got if n in held[each.name]}
            probe.expect({n: got[n] for n in wanted}, equal=wanted, refutes=text, exchange=exchange, key=f"{each.name} lost")
    expect_effects(probe, chosen, held, f"{way.how} before a restart")
