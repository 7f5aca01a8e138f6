"""Ranges of the LK control parameters, and of the two commands that a model has one of.

lowest, highest    of each parameter: what a drive holds then is observed
reserved           the bytes beside a parameter change nothing
unlisted           writing a number that is not listed changes no listed one
models             a motor has the torque of an MF, MG or MH, or the power of an MS, and not both
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer import encoder
from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Form, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.ranges_lk_looks import LOOK_NS, STILL
from conformance.claims.requests import with_reserved
from conformance.model import limits
from conformance.model.lk_parameters import OTHER_FIRMWARE, read_parameter
from conformance.motion import motion
from conformance.talk.probe import Probe


def parameters(dialect: Dialect, command: Command) -> Iterator[Claim]:
    """Make the claims about writing control parameters."""
    for form in command.request_forms:
        yield from _parameter(dialect, command, form)


def _parameter(dialect: Dialect, command: Command, form: Form) -> Iterator[Claim]:
    number = form.layout.named["parameter"].fixed
    if number is None:
        yield _unlisted_parameter(dialect, command)
        return
    risks = command.risks({"parameter": number})
    for field in form.layout.named.values():
        for what, value in (("lowest", field.low), ("highest", field.high)):
            if field.fixed is None:
                yield _parameter_edge(dialect, command, form, field, what, value)
    masks = limits.reserved_masks(form.layout)
    if masks:

        def check(probe: Probe) -> None:
            before = read_parameter(probe, number)
            probe.do(command, before)
            if read_parameter(probe, number) != before:
                raise Inconclusive(f"{form.name} is not held as it was read: another claim is about that")
            exchange = probe.ask_built(with_reserved(probe, command, form, before, sum(masks)))
            probe.reply(exchange)
            now = read_parameter(probe, number)
            if now != before:
                text = f"{form.name} changes by its reserved bytes"
                raise Refuted(text, expected=str(before), got=str(now), exchange=exchange)

        yield declare(
            dialect, Theme.RANGES, f"{command.name}/{form.name}/reserved", f"The reserved bytes of {form.name} change nothing.",
            "another value of the parameter", check, command=command, rests_on=(Doubt.RESERVED,), aspect=Aspect.RANGE,
            risks=risks, quirks=(OTHER_FIRMWARE,), settings=(form.name,), parameters={"mask": sum(masks)},
        )  # fmt: skip


def _parameter_edge(dialect: Dialect, command: Command, form: Form, field: Field, what: str, value: int) -> Claim:
    number = form.layout.named["parameter"].fixed or 0

    def check(probe: Probe) -> None:
        before = read_parameter(probe, number)
        exchange = probe.ask(command, before | {field.name: value}, form=form)
        probe.reply(exchange)
        now = read_parameter(probe, number)
        probe.ask(command, before, form=form)
        if now.get(field.name) != value:
            raise Refuted(
                f"{field.name} {value} is held as {now.get(field.name)}", expected=f"{value}", got=f"{now.get(field.name)}",
                exchange=exchange,
            )  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", f"The {what} {field.name} is held as it was sent.",
        "another value", check, command=command, rests_on=(Doubt.LIMITS,), aspect=Aspect.BOUNDARY,
        fields=(field.name,), risks=command.risks({"parameter": number}), quirks=(OTHER_FIRMWARE,), settings=(form.name,),
        parameters={"field": field.name, "value": value},
    )  # fmt: skip


def _unlisted_parameter(dialect: Dialect, command: Command) -> Claim:
    listed = [int(f.layout.named["parameter"].fixed or 0) for f in command.request_forms]
    numbers = tuple(n for n in (0, 9, 13, 29, 31, 33, 35, 37, 39, 255) if n not in listed)

    def check(probe: Probe) -> None:
        before = {n: read_parameter(probe, n) for n in listed if n}
        for number in numbers:
            exchange = probe.ask(command, {"parameter": number, "parameter_bytes": 0x0102_0304_0506})
            now = {n: read_parameter(probe, n) for n in listed if n}
            if now != before:
                raise Refuted(
                    f"writing parameter {number}, which is not listed, changes another", expected=str(before), got=str(now),
                    exchange=exchange, key="unlisted parameter",
                )  # fmt: skip

    risks = set().union(*(command.risks({"parameter": n}) for n in numbers))
    statement = "Writing a parameter that is not listed changes no listed one."
    return declare(
        dialect, Theme.RANGES, f"{command.name}/parameter/unlisted", statement,
        "another value of a listed parameter", check, command=command, at_best=Certainty.LIKELY, aspect=Aspect.RANGE,
        fields=("parameter",), risks=risks, quirks=(OTHER_FIRMWARE,), parameters={"values": numbers},
    )  # fmt: skip


# --- models -----------------------------------------------------------------------------------------------------------


def models(dialect: Dialect) -> Iterator[Claim]:
    """Make the claim that a drive obeys the torque command or the power command, by its model, and not both."""
    whole = dialect.whole
    if not {Verb.RUN_TORQUE, Verb.RUN_OPEN_LOOP} <= whole.by_verb.keys():
        return
    torque, power = whole.by_verb[Verb.RUN_TORQUE], whole.by_verb[Verb.RUN_OPEN_LOOP]

    def check(probe: Probe) -> None:
        obeyed = []
        for command in (torque, power):
            motion.ready_to_move(probe)
            name, field = next(iter(command.request_forms[0].layout.named.items()))
            start = motion.position(probe)
            probe.send(frame_of(probe, whole, command, {name: field.high // 4}), timeout_ns=LOOK_NS)
            gone = motion.position(probe).value - start.value
            motion.stand_still(probe)
            if abs(gone) > STILL:
                obeyed.append(command)
        foreign = [c for c in obeyed if probe.rig.model and probe.rig.model not in c.models]
        if len(obeyed) == 2 or foreign:
            names = " and ".join(c.name for c in obeyed)
            raise Refuted(f"the drive obeys {names}", expected=_whose(torque, power), got=f"{names} obeyed", key="model")
        if not obeyed:
            raise Inconclusive("neither command turns the shaft")

    yield declare(
        dialect, Theme.RANGES, "models", f"A motor obeys one of {torque.name} and {power.name}: {_whose(torque, power)}.",
        "a motor that obeys both, or the other model's", check, section=f"{power.section}, {torque.section}",
        at_best=Certainty.LIKELY, risks=motion.risks(dialect, Risk.UNBOUNDED, Risk.TORQUE),
        commands=(torque.name, power.name),
    )  # fmt: skip


def frame_of(probe: Probe, dialect: Dialect, command: Command, values: dict[str, int]) -> bytes:
    """Return the frame of a command that the drive's own model may not have."""
    return encoder.build(dialect, command, probe.address, values)


def _whose(torque: Command, power: Command) -> str:
    return f"{torque.name} belongs to {', '.join(torque.models)}, {power.name} to {', '.join(power.models)}"
