"""Settings that a drive takes in every state: the command and values that set each, and the read that shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from analyzer.catalogue import Command, Dialect, Form, Risk, Verb
from conformance.claims.settings import setting_effects
from conformance.claims.settings.setting_effects import differing, stored
from conformance.model import limits, lk_parameters
from conformance.safety.settings import changes
from conformance.talk import samples
from conformance.talk.acceptance import can_refuse
from conformance.talk.probe import Probe

#: What a drive does at power-on, where it is reached, and what wears: other claims set that.
_NOT_HERE = frozenset({Risk.LINK, Risk.POWER_ON, Risk.WEAR, Risk.UNKNOWN})
_IDS = ({"user_id": 0x1234_5678}, {"user_id": 0x2143_6587})


@dataclass(frozen=True)
class Setting:
    """A setting. `values`: two sets that differ, in whole."""

    command: Command
    form: Form
    values: tuple[Mapping[str, int], Mapping[str, int]]

    @property
    def name(self) -> str:
        """The name of the command, or of the parameter that it writes."""
        return self.command.name if self.command.verb is not Verb.WRITE_PARAMETER else self.form.name

    @property
    def names(self) -> tuple[str, ...]:
        """The names of what it sets."""
        return tuple(n for n in self.form.layout.named if n != "parameter")

    @property
    def wrong(self) -> tuple[dict[str, int], ...]:
        """Values of which the manual forbids one, each field in turn; none where it forbids none, or no reply can say so."""
        named = self.form.layout.named.items() if can_refuse(self.command) else ()
        # A limit that the models do not share is one of the ranges.
        beyond = {name: limits.beyond(field) for name, field in named if not field.models}
        return tuple({**self.values[1], name: values[-1]} for name, values in beyond.items() if values)

    @property
    def risks(self) -> frozenset[Risk]:
        """What it risks."""
        return frozenset().union(*(self.command.risks(values) for values in self.values))

    def other(self, was: Mapping[str, int], which: int = 0) -> Mapping[str, int]:
        """Return one of the two sets that is not what was read."""
        found = (self.values[which], self.values[1 - which])
        return next(values for values in found if any(was.get(n) != v for n, v in values.items()))


@dataclass(frozen=True)
class ReadableSetting(Setting):
    """A setting that a read shows."""

    read: Callable[[Probe], Mapping[str, int]]


def every_setting(dialect: Dialect) -> Iterator[Setting]:
    """Yield the settings of a dialect in the manual's order; control parameters one by one."""
    # A drive that tells some of its settings tells no others: those cannot be put back.
    reads = Verb.READ_PARAMETER in dialect.by_verb
    for command in dialect.commands:
        form = command.request_forms[0]
        if command.readable and Risk.LINK not in command.all_risks:
            yield ReadableSetting(command, form, differing(form), partial(_read, command=command))
        elif command.verb is Verb.WRITE_USER_ID:
            yield ReadableSetting(command, form, _IDS, partial(_read_one, verb=Verb.READ_USER_ID, field="user_id"))
        elif command.verb is Verb.WRITE_PARAMETER:
            for listed in lk_parameters.listed(command):
                values = lk_parameters.moderate(listed, 0), lk_parameters.moderate(listed, 1)
                read = partial(lk_parameters.read_parameter, number=lk_parameters.number_of(listed))
                yield ReadableSetting(command, listed, values, read)
        elif not reads and changes(command) and Risk.SETTING in command.all_risks and not command.all_risks & _NOT_HERE:
            effect = setting_effects.BY_VERB.get(command.verb)
            shown = effect.values[:2] if effect is not None else differing(form)
            plain = samples.sample(dialect, command)
            one, two = ({**plain, **values} for values in shown)
            yield Setting(command, form, (one, two))


def readable_settings(dialect: Dialect) -> list[ReadableSetting]:
    """Return the settings that a read shows."""
    return [each for each in every_setting(dialect) if isinstance(each, ReadableSetting)]


def _read_one(probe: Probe, verb: Verb, field: str) -> Mapping[str, int]:
    return {field: probe.read(verb, field)}


def _read(probe: Probe, command: Command) -> Mapping[str, int]:
    return stored(probe, command)[0]


def needs(chosen: Iterable[Setting]) -> tuple[frozenset[Risk], tuple[str, ...]]:
    """Return what settings risk, and the names of what they set."""
    every = tuple(chosen)
    names = dict.fromkeys(name for each in every for name in each.names)
    return frozenset[Risk]().union(*(each.risks for each in every)), tuple(names)
