"""Read-back: what is set is what is read, stored in its own place. For settings that can be read.

    read       what is set is what the parameter read answers (CAN 00, LK 0xC0)

Other modules judge the rest of a setting: `resilience.settings` that it changes no other, `settings.effects` its effect,
`restart` and `restore` what is left of it afterwards.

Rules kept here:
- Which settings of a CAN drive can be read is open (the manual names two): one that cannot be read is observed. One that
  can be read must read as it was set.
- Values are such that swapped bytes, a neighbour's place and a missing byte show.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Command, Dialect, Doubt, Form, Verb
from analyzer.layout import Effect, Field
from conformance.claim import Aspect, Observed, Theme
from conformance.claims.declare import Case, claim, commands
from conformance.claims.ranges import edges
from conformance.claims.settings.setting_effects import differing
from conformance.claims.settings.setting_effects import stored as stored_values
from conformance.model import limits, lk_parameters
from conformance.model.lk_parameters import OTHER_FIRMWARE, number_of, read_parameter
from conformance.talk import samples, settings
from conformance.talk.acceptance import need_plain_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: Declares a check as claims about what is stored.
of_read_back = partial(claim, Theme.READ_BACK, first=need_plain_replies, aspect=Aspect.STATE)
#: How many numbers are tried between the ends of a range.
_BETWEEN = 3


def fields_of(case: Case) -> tuple[str, ...]:
    """Return the names of the fields of a case's command."""
    assert case.command is not None  # only cases of commands are asked for
    return tuple(case.command.request_forms[0].layout.named)


def stored(probe: Probe, command: Command) -> tuple[dict[str, int], Exchange]:
    """Return the stored values of a setting and the exchange that read them.

    Raises Observed where it cannot be read, Inconclusive where it is not answered or by another layout.
    """
    return stored_values(probe, command, cannot=Observed)


def expect_values(
    probe: Probe, command: Command, wanted: Mapping[str, int], got: Mapping[str, int], exchange: Exchange | None, when: str
) -> None:
    """Refute the claim where values differ. `when`: after what they were read."""
    wrong = {n: v for n, v in got.items() if n in wanted and wanted[n] != v}
    shown = ", ".join(f"{n} {v}" for n, v in wrong.items())
    expected = ", ".join(f"{n} {wanted[n]}" for n in wrong)
    probe.expect(
        shown,
        holds=not wrong,
        expected=expected,
        refutes=f"{command.name} {when}: {shown}, expected {expected}",
        exchange=exchange,
        key=f"{command.name} {when}",
    )


# --- settings ---------------------------------------------------------------------------------------------------------


def _told_apart(form: Form) -> list[dict[str, int]]:
    """Return sets of values that differ in every field; where a set has a value twice, one more that tells the fields apart."""
    one, two = differing(form)
    alike = len(set(one.values())) < len(one)
    mixed = {name: (one if number % 2 else two)[name] for number, name in enumerate(one)}
    return [one, two, mixed] if alike else [one, two]


def _readable(dialect: Dialect) -> Iterator[Case]:
    for command in dialect.commands:
        if command.readable and not settings.changes_link(command):
            yield Case(dialect, command, {}, edges.needs(dialect, command, _told_apart(command.request_forms[0])))


@of_read_back(each=_readable, refuted_by="another value", rests_on=(Doubt.LAYOUT,), fields=fields_of)
def _read(probe: Probe, command: Command) -> None:
    """What {command} sets is what is read."""
    edges.prepare(probe, command)
    for values in _told_apart(command.request_forms[0]):
        probe.do(command, values)
        got, exchange = stored(probe, command)
        expect_values(probe, command, values, got, exchange, "is read as")


def _numbers(command: Command) -> list[Field]:
    """Return the fields of a setting that hold a number. The lowest group can be the drive's own address."""
    fields = command.request_forms[0].layout.named.values()
    return [f for f in fields if f.fixed is None and limits.listed(f) is None and f.effect is not Effect.GROUP]


def _tried(field: Field) -> tuple[int, ...]:
    return (field.high, field.low, *limits.across(field, _BETWEEN))


def _with_numbers(dialect: Dialect) -> Iterator[Case]:
    for case in _readable(dialect):
        command = case.command
        if command is not None and (numbers := _numbers(command)):
            plain = samples.sample(dialect, command)
            sent = [plain | {f.name: v} for f in numbers for v in _tried(f)]
            yield Case(dialect, command, {}, {**edges.needs(dialect, command, sent), "parameters": {}})


@of_read_back(
    each=_with_numbers,
    name="{command}/ends",
    refuted_by="another value",
    rests_on=(Doubt.LAYOUT,),
    fields=lambda case: tuple(f.name for f in _numbers(case.command)) if case.command is not None else (),
)
def _at_its_ends(probe: Probe, command: Command) -> None:
    """The highest and the lowest number that {command} sets, and some between, is what is read."""
    edges.prepare(probe, command)
    plain = samples.sample(probe.dialect, command, address=probe.address)
    for field in _numbers(command):
        edges.need_model(probe, field)
        for value in _tried(field):
            exchange = probe.ask(command, plain | {field.name: value}, quiet_ns=0)
            if probe.refused(exchange):
                # Whether it is accepted is another claim's.
                continue
            got, exchange = stored(probe, command)
            expect_values(probe, command, {field.name: value}, got, exchange, "is read as")


def _link_settings(dialect: Dialect) -> Iterator[Case]:
    for effect in settings.LINK_EFFECTS:
        for command, field in dialect.effects(effect):
            if command.readable:
                yield Case(dialect, command, {"field": field}, {"fields": (field.name,), "parameters": {}})


@of_read_back(each=_link_settings, name="{command}/read", refuted_by="another value")
def _link(probe: Probe, command: Command, field: Field) -> None:
    """{field} reads as the drive is reached."""
    wanted = probe.address
    if field.effect is Effect.BAUD_RATE:
        rate = probe.gate.line.endpoint.bits_per_second
        wanted = next((v for v, r in probe.dialect.rates.items() if r == rate), -1)
    got, exchange = stored(probe, command)
    expect_values(probe, command, {field.name: wanted}, got, exchange, "is read as")


@of_read_back(
    each=commands(Verb.WRITE_USER_ID),
    name="{command}/read",
    refuted_by="another number",
    fields=fields_of,
    settings=fields_of,
    risks=lambda case: case.command.all_risks,
)
def _user_id(probe: Probe, command: Command) -> None:
    """The user's number reads as it was written."""
    field = next(iter(command.request_forms[0].layout.named.values()))
    for value in (0x01020304, field.high, 0x80000000, field.low):
        exchange = probe.do(command, {field.name: value})
        got = probe.read(Verb.READ_USER_ID)
        expect_values(probe, command, {field.name: value}, {field.name: got}, exchange, "is read as")


# --- control parameters (LK) ------------------------------------------------------------------------------------------


def parameters(dialect: Dialect) -> Iterator[Case]:
    """Yield the control parameters that a dialect lists, each as a form of the write."""
    command = dialect.by_verb.get(Verb.WRITE_PARAMETER)
    for form in lk_parameters.listed(command) if command is not None else ():
        facts: dict[str, Any] = {
            "risks": command.risks({"parameter": number_of(form)}) if command is not None else (),
            "settings": (form.name,),
            "quirks": (OTHER_FIRMWARE,),
            "fields": tuple(n for n, f in form.layout.named.items() if f.fixed is None),
            "parameters": {},
        }
        yield Case(dialect, command, {"form": form}, facts)


@of_read_back(each=parameters, name="parameter/{form}/written", refuted_by="another value")
def _written(probe: Probe, command: Command, form: Form) -> None:
    """{form} is held, answered and read as it was written."""
    before = read_parameter(probe, number_of(form))
    for which in (0, 1):
        wanted = lk_parameters.moderate(form, which)
        exchange = probe.ask(command, wanted, form=form)
        answered = {n: int(v) for n, v in probe.reply(exchange).values.items()}
        held = read_parameter(probe, number_of(form))
        probe.do(command, before)
        got = f"0xC1 answers {text(answered)}, 0xC0 reads {text(held)}"
        probe.expect(
            got,
            holds=held == wanted == answered,
            expected=text(wanted),
            refutes=f"{form.name} written {text(wanted)}: {got}",
            exchange=exchange,
            key=f"{form.name} written",
        )


def text(values: Mapping[str, int]) -> str:
    """Return the values of a parameter for people."""
    return " ".join(f"{n} {v}" for n, v in values.items() if n != "parameter")
