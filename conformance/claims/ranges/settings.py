"""Ranges of settings: a drive does what the manual lists and refuses all else, and a refused value changes nothing.

For commands whose replies can say that they were refused.

Rules kept here:
- All fields but the one in question have plain values (`conformance.talk.samples`), where a claim does not say otherwise.
- Where the limit is one of the model, a drive on hardware is only judged when its model is known.
- That a value outside is refused is likely, not certain: the manuals list the values and say "set fail" without saying when.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Aspect, Inconclusive
from conformance.claims.declare import Case
from conformance.claims.ranges import edges, motions
from conformance.claims.ranges.edges import of_ranges
from conformance.claims.requests import with_reserved
from conformance.claims.settings import setting_effects
from conformance.claims.settings.known_settings import every_setting
from conformance.claims.settings.setting_effects import SettingEffect
from conformance.model import limits
from conformance.talk import samples
from conformance.talk.acceptance import Acceptance, can_refuse, expect_accepted, expect_refused, try_request
from conformance.talk.probe import Probe
from conformance.talk.settings import LINK_EFFECTS, read_back

_BYTE = 0xFF
#: Values of these do something that no claim about ranges needs; other claims are about what they do.
_NOT_DONE = frozenset({Verb.RESTART, Verb.RESTORE, Verb.CALIBRATE, Verb.HOME})


def _judged(dialect: Dialect) -> Iterator[Command]:
    """Yield the commands whose values are judged here: those that can be refused, and move nothing."""
    for command in dialect.commands:
        reads = command.all_risks <= {Risk.READ}
        if can_refuse(command) and not reads and command.slots is None and not motions.turns(command):
            yield command


def _case(dialect: Dialect, command: Command, field: Field, where: str, values: tuple[int, ...]) -> Case:
    plain = samples.sample(dialect, command, edges.form_of(command, field))
    sent = [plain | {field.name: v} for v in values or (field.low, field.high)]
    needs = edges.needs(dialect, command, sent)
    return edges.case(dialect, command, field, where, values, rests_on=edges.doubts(where), **needs)


def _allowed(dialect: Dialect) -> Iterator[Case]:
    for command in _judged(dialect):
        for field in edges.fields(command):
            if command.verb not in _NOT_DONE and field.effect not in LINK_EFFECTS:
                for where, values in edges.allowed(field).items():
                    yield _case(dialect, command, field, where, values)


def _forbidden(dialect: Dialect) -> Iterator[Case]:
    for command in _judged(dialect):
        for field in edges.fields(command):
            for where, values in edges.forbidden(dialect, command, field, far=True).items():
                yield _case(dialect, command, field, where, values)


@of_ranges(each=_allowed, refuted_by="a refusal")
def _accepted(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """{where} of {field} is accepted, and read as it was set by a drive that can tell it."""
    edges.need_model(probe, field)
    edges.prepare(probe, command)
    form = edges.form_of(command, field)
    for value in edges.tried(probe, command, field, values):
        asked = edges.plain(probe, command, form, **{field.name: value})
        expect_accepted(probe, command, asked, edges.text(field, value), form=form)
        told, exchange = read_back(probe, command) if command.readable else (None, None)
        if told:
            text = f"{command.name}: {edges.text(field, value)} is read as {told.get(field.name)}"
            key = f"{command.name} is read otherwise"
            probe.expect(told.get(field.name), equal=value, refutes=text, exchange=exchange, key=key)
    _keep_enabled(probe, command)


@of_ranges(each=_forbidden, refuted_by="success, or silence", at_best=Certainty.LIKELY)
def _refused(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """{where} of {field} is refused."""
    edges.need_model(probe, field)
    edges.prepare(probe, command)
    form = edges.form_of(command, field)
    for value in values:
        asked = edges.plain(probe, command, form, **{field.name: value})
        expect_refused(probe, probe.build(command, asked, form=form), edges.text(field, value))
    _keep_enabled(probe, command)


def _corners(dialect: Dialect, command: Command) -> Iterator[tuple[Field, int, dict[str, int]]]:
    """Yield what is forbidden of a request of several fields: the field, its value, and the others at one of their ends.

    A field whose limits are those of a model stays plain beside another one.
    """
    for field in edges.fields(command):
        form, wrong = edges.form_of(command, field), limits.beyond(field)
        others = [f for f in edges.fields(command) if f.name in form.layout.named and f is not field and not f.models]
        for value in dict.fromkeys((*wrong[:1], *wrong[-1:])) if others else ():
            for end in (-1, 0):
                yield field, value, {f.name: limits.edges(f)[end] for f in others}


def _at_corners(dialect: Dialect) -> Iterator[Case]:
    for command in _judged(dialect):
        rows = tuple(_corners(dialect, command))
        if rows:
            sent = [samples.sample(dialect, command, edges.form_of(command, f)) | {f.name: v} | more for f, v, more in rows]
            names = tuple(dict.fromkeys(field.name for field, _, _ in rows))
            facts = {**edges.needs(dialect, command, sent), "fields": names, "parameters": {}}
            yield Case(dialect, command, {"rows": rows}, facts)


@of_ranges(
    each=_at_corners,
    name="{command}/at-corners",
    refuted_by="success, or silence",
    at_best=Certainty.LIKELY,
    rests_on=edges.doubts("unlisted"),
    aspect=Aspect.BOUNDARY,
)
def _refused_at_corners(probe: Probe, command: Command, rows: Sequence[tuple[Field, int, dict[str, int]]]) -> None:
    """A value next to the limits of a field is refused where the others have their highest values, and where their lowest."""
    edges.prepare(probe, command)
    for field, value, others in rows:
        if field.models and not probe.rig.model and not probe.rig.emulated:
            continue
        form = edges.form_of(command, field)
        asked = edges.plain(probe, command, form, **others, **{field.name: value})
        shown = ", ".join((edges.text(field, value), *(f"{n} {v}" for n, v in others.items())))
        expect_refused(probe, probe.build(command, asked, form=form), shown)


def _bytes_with_a_list(dialect: Dialect) -> Iterator[tuple[Command, Field]]:
    """Yield the settings of a byte whose values are listed."""
    for command in _judged(dialect):
        for field in edges.fields(command):
            changes_link = field.effect in LINK_EFFECTS or command.verb in _NOT_DONE
            if limits.listed(field) is not None and field.wire_maximum == _BYTE and not changes_link:
                yield command, field


def _every_other(dialect: Dialect) -> Iterator[Case]:
    for command, field in _bytes_with_a_list(dialect):
        yield _other(dialect, command, field, "every", range(_BYTE + 1))


def _round(dialect: Dialect) -> Iterator[Case]:
    """Yield numbers that a list leaves out. A field with named choices has no number that looks like one of them."""
    for command, field in _bytes_with_a_list(dialect):
        if field.values is not None:
            yield _other(dialect, command, field, "round", range(10, _BYTE + 1, 10))


def _other(dialect: Dialect, command: Command, field: Field, where: str, values: Iterable[int]) -> Case:
    others = tuple(v for v in values if not field.allows(v))
    case = _case(dialect, command, field, where, others)
    return replace(case, facts={**case.facts, "rests_on": edges.doubts("unlisted"), "parameters": {"field": field.name}})


@of_ranges(
    each=_every_other,
    statement="Of the 256 values of a byte those that are not listed of {field} are refused.",
    refuted_by="success, or silence",
    at_best=Certainty.LIKELY,
    emulated=True,
)
@of_ranges(
    each=_round,
    statement="A multiple of ten that is not listed of {field} is refused.",
    refuted_by="success, or silence",
    at_best=Certainty.LIKELY,
)
def _others_refused(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    _refused(probe, command, field, values)


def _keep_enabled(probe: Probe, command: Command) -> None:
    """Leave the motor enabled and standing where a command may have changed that."""
    if command.verb is Verb.ENABLE:
        probe.ask(command, {"enabled": 1})
    if command.verb is Verb.HOME:
        probe.ask(Verb.EMERGENCY_STOP)


# --- what a refused value leaves alone --------------------------------------------------------------------------------


def _visible(dialect: Dialect) -> Iterator[Case]:
    """Yield the fields of commands that show, with two values that are forbidden; settings stand in `resilience.settings`."""
    others = {each.command.name for each in every_setting(dialect)}
    for command in _judged(dialect):
        effect = setting_effects.of(dialect, command) if command.name not in others else None
        for field in edges.fields(command) if effect is not None else ():
            wrong = limits.beyond(field)
            if effect is not None and wrong:
                bad = (wrong[0], wrong[-1])
                facts = _needs(dialect, command, field, effect, bad)
                yield Case(dialect, command, {"field": field, "effect": effect, "values": bad}, facts)


def _needs(dialect: Dialect, command: Command, field: Field, effect: SettingEffect, bad: tuple[int, int]) -> dict[str, object]:
    form = edges.form_of(command, field)
    base, (kept, other) = samples.sample(dialect, command, form), effect.pair(form)
    needs = edges.needs(dialect, command, [base | kept, *(base | other | {field.name: v} for v in bad)])
    return effect.needed(dialect, needs) | {
        "name": f"{{command}}/{field.name}/unchanged",
        "fields": (field.name,),
        "parameters": {"field": field.name, "values": bad},
    }


@of_ranges(
    each=_visible,
    refuted_by="what the drive had before has changed",
    at_best=Certainty.LIKELY,
    rests_on=edges.doubts("unlisted"),
    aspect=Aspect.RANGE,
)
def _unchanged(probe: Probe, command: Command, field: Field, effect: SettingEffect, values: tuple[int, int]) -> None:
    """A request with a forbidden {field} changes nothing."""
    form = edges.form_of(command, field)
    kept, other = effect.pair(form)
    edges.need_model(probe, field)
    effect.ready(probe)
    edges.prepare(probe, command)
    if effect.set_first:
        probe.do(command, edges.plain(probe, command, form, **kept))
    before = effect.see(probe)
    for value in dict.fromkeys(values):
        asked = edges.plain(probe, command, form, **other) | {field.name: value}
        answer, exchange = try_request(probe, probe.build(command, asked, form=form))
        shown = edges.text(field, value)
        if answer is not Acceptance.REFUSED:
            raise Inconclusive(f"{shown} is {answer.value}, which another claim of this field judges")
        text = f"{command.name}: {shown} is refused and changes something"
        effect.expect(probe, effect.see(probe), before, text, exchange, f"{command.name} refused and stored")


# --- reserved bits ----------------------------------------------------------------------------------------------------


def _with_reserved_bits(dialect: Dialect) -> Iterator[Case]:
    """Yield the requests with bits that are to be 0. In a register they are the high byte: another value of the field."""
    for command in _judged(dialect):
        form = command.request_forms[0]
        masks = limits.reserved_masks(form.layout)
        if masks:
            register = command.function is not None
            words = "A register whose high byte is not 0" if register else "A request whose reserved bits are not 0"
            facts = {
                "at_best": Certainty.LIKELY if register else Certainty.OPEN,
                **edges.needs(dialect, command, [samples.sample(dialect, command, form)]),
            }
            yield Case(dialect, command, {"what": words, "masks": masks}, facts | {"parameters": {"masks": masks}})


@of_ranges(each=_with_reserved_bits, refuted_by="success, or silence", aspect=Aspect.RANGE)
def _reserved(probe: Probe, command: Command, masks: tuple[int, ...]) -> None:
    """{what} is refused."""
    edges.prepare(probe, command)
    form = command.request_forms[0]
    values = edges.plain(probe, command, form)
    for mask in masks:
        built = with_reserved(probe, command, form, values, mask)
        expect_refused(probe, built, f"a value with the bit {mask:#x} that is to be 0")
