"""Ranges of values that LK drives store: control parameters, and positions that are set.

lowest, highest    of each parameter: what a drive holds then is observed
reserved           the bytes beside a parameter change nothing
unlisted           writing a number that is not listed changes no listed one
set_position       what is set is read, up to the limits of the type
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Form, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Aspect, Inconclusive
from conformance.claims.declare import Case
from conformance.claims.ranges import edges
from conformance.claims.ranges.edges import of_ranges
from conformance.claims.requests import with_reserved
from conformance.model import limits
from conformance.model.lk_parameters import OTHER_FIRMWARE, listed, number_of, read_parameter
from conformance.motion import declared, motion
from conformance.talk.probe import Probe

#: Numbers that no parameter has in the manual; most are next to a listed one.
_NUMBERS = (0, 9, 13, 29, 31, 33, 35, 37, 39, 255)
#: A position that was just set may be off by so many degrees, and by the noise.
_SAME = 0.3


def _forms(dialect: Dialect) -> Iterator[tuple[Command, Form]]:
    command = dialect.by_verb.get(Verb.WRITE_PARAMETER)
    if command is not None:
        for form in listed(command):
            yield command, form


def _edges(dialect: Dialect) -> Iterator[Case]:
    for command, form in _forms(dialect):
        for field in form.layout.named.values():
            for where, value in (("lowest", field.low), ("highest", field.high)) if field.fixed is None else ():
                facts = {
                    "parameters": {"field": field.name, "value": value},
                    "risks": command.risks({"parameter": number_of(form)}),
                    "settings": (form.name,),
                }
                case = edges.case(dialect, command, field, where, (value,), **facts)
                yield Case(dialect, command, {**case.given, "form": form, "value": value, "where": where}, case.facts)


@of_ranges(each=_edges, refuted_by="another value", rests_on=(Doubt.LIMITS,), quirks=(OTHER_FIRMWARE,))
def _held(probe: Probe, command: Command, form: Form, field: Field, value: int) -> None:
    """The {where} {field} is held as it was sent."""
    before = read_parameter(probe, number_of(form))
    exchange = probe.ask(command, before | {field.name: value}, form=form)
    probe.reply(exchange)
    got = read_parameter(probe, number_of(form)).get(field.name)
    probe.ask(command, before, form=form)
    probe.expect(got, equal=value, refutes=f"{field.name} {value} is held as {got}", exchange=exchange)


def _with_reserved_bytes(dialect: Dialect) -> Iterator[Case]:
    for command, form in _forms(dialect):
        mask = sum(limits.reserved_masks(form.layout))
        if mask:
            facts = {
                "parameters": {"mask": mask},
                "risks": command.risks({"parameter": number_of(form)}),
                "settings": (form.name,),
            }
            yield Case(dialect, command, {"form": form, "mask": mask}, facts)


@of_ranges(
    each=_with_reserved_bytes,
    name="{command}/{form}/reserved",
    refuted_by="another value of the parameter",
    rests_on=(Doubt.RESERVED,),
    aspect=Aspect.RANGE,
    quirks=(OTHER_FIRMWARE,),
)
def _reserved(probe: Probe, command: Command, form: Form, mask: int) -> None:
    """The reserved bytes of {form} change nothing."""
    number = number_of(form)
    before = read_parameter(probe, number)
    probe.do(command, before)
    if read_parameter(probe, number) != before:
        raise Inconclusive(f"{form.name} is not held as it was read, which its read-back judges")
    exchange = probe.ask_built(with_reserved(probe, command, form, before, mask))
    probe.reply(exchange)
    now = read_parameter(probe, number)
    probe.expect(now, equal=before, refutes=f"{form.name} changes by its reserved bytes", exchange=exchange)


def _unlisted_numbers(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.WRITE_PARAMETER)
    if command is not None:
        known = {number_of(form) for form in command.request_forms}
        values = tuple(n for n in _NUMBERS if n not in known)
        risks = frozenset().union(*(command.risks({"parameter": n}) for n in values))
        yield Case(dialect, command, {"values": values}, {"risks": risks})


@of_ranges(
    each=_unlisted_numbers,
    name="{command}/parameter/unlisted",
    refuted_by="another value of a listed parameter",
    at_best=Certainty.LIKELY,
    aspect=Aspect.RANGE,
    fields=("parameter",),
    quirks=(OTHER_FIRMWARE,),
)
def _unlisted(probe: Probe, command: Command, values: tuple[int, ...]) -> None:
    """Writing a parameter that is not listed changes no listed one."""
    numbers = [number_of(form) for form in listed(command)]
    before = {n: read_parameter(probe, n) for n in numbers}
    for number in values:
        exchange = probe.ask(command, {"parameter": number, "parameter_bytes": 0x0102_0304_0506})
        now = {n: read_parameter(probe, n) for n in numbers}
        text = f"writing parameter {number}, which is not listed, changes another"
        probe.expect(now, equal=before, refutes=text, exchange=exchange, key="unlisted parameter")


def _positions(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_name.get("set_position")
    if command is not None and Verb.MOTOR_ON in dialect.by_verb:
        field = command.request_forms[0].layout.named["position"]
        inner = (0x01020304, -0x01020304, 1, -1, 0)
        facts = {"risks": declared.risks(dialect, Risk.SETTING), "settings": ("position",)}
        for where, values in (("lowest", (field.low,)), ("highest", (field.high,)), ("inside", inner)):
            yield edges.case(dialect, command, field, where, values, **facts)


@of_ranges(
    each=_positions,
    statement=lambda case: f"{case['where'].replace('value', 'position')} that is set is read.",
    refuted_by="another position",
)
def _read(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    motion.stand_still(probe)
    for value in values:
        exchange = probe.do(command, {field.name: value})
        now = probe.read(Verb.READ_POSITION)
        text, key = f"{command.name} {value} is read as {now}", f"{command.name} not stored"
        degrees, wanted = now * float(field.scale), value * float(field.scale)
        probe.expect(degrees, near=wanted, within=_SAME, unit="degrees", refutes=text, exchange=exchange, key=key)
