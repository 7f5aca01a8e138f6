"""Read-back of LK drives: what 0xC1 writes is what 0xC0 reads, and it is gone with the power.

    parameter/NAME/written    0xC1 answers what it holds, and 0xC0 reads it
    parameter/NAME/others     no other parameter changes
    parameter/NAME/power      it is as before when power comes on (emulated)

Positions, zero, encoder and brake are read back where motion is judged (`motion_lk`).

Rules kept here:
- Values are moderate: what a drive does at the ends of their types is open (`ranges_lk`).
- A firmware without 0xC0 and 0xC1 was seen: those claims observe it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Command, Dialect, Form, Verb
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.model.lk_parameters import OTHER_FIRMWARE, moderate, number_of, read_parameter
from conformance.talk.probe import Probe
from conformance.talk.restarts import power_cycle


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for LK drives."""
    verbs = dialect.by_verb
    if Verb.WRITE_PARAMETER not in verbs:
        return
    forms = [f for f in verbs[Verb.WRITE_PARAMETER].request_forms if f.layout.named["parameter"].fixed is not None]
    for form in forms:
        yield from _parameter(dialect, verbs[Verb.WRITE_PARAMETER], form, forms)


# --- parameters -------------------------------------------------------------------------------------------------------


def _parameter(dialect: Dialect, command: Command, form: Form, forms: list[Form]) -> Iterator[Claim]:
    number = number_of(form)
    needs: dict[str, Any] = {
        "risks": command.risks({"parameter": number}), "settings": (form.name,), "quirks": (OTHER_FIRMWARE,),
        "fields": tuple(n for n, f in form.layout.named.items() if f.fixed is None),
    }  # fmt: skip

    def written(probe: Probe) -> None:
        before = read_parameter(probe, number)
        for which in (0, 1):
            wanted = moderate(form, which)
            exchange = probe.ask(command, wanted, form=form)
            told = {n: int(v) for n, v in probe.reply(exchange).values.items()}
            held = read_parameter(probe, number)
            probe.do(command, before)
            if held != wanted or told != wanted:
                raise Refuted(
                    f"{form.name} written {_shown(wanted)}: 0xC1 answers {_shown(told)}, 0xC0 reads {_shown(held)}",
                    expected=_shown(wanted), got=f"{_shown(told)}; {_shown(held)}", exchange=exchange,
                    key=f"{form.name} written",
                )  # fmt: skip

    def others(probe: Probe) -> None:
        rest = [number_of(f) for f in forms if f is not form]
        before = read_parameter(probe, number)
        was = {n: read_parameter(probe, n) for n in rest}
        exchange = probe.do(command, moderate(form, 0))
        now = {n: read_parameter(probe, n) for n in rest}
        probe.do(command, before)
        changed = [n for n in rest if now[n] != was[n]]
        if changed:
            raise Refuted(
                f"writing {form.name} changes parameter {changed[0]}", expected=_shown(was[changed[0]]),
                got=_shown(now[changed[0]]), exchange=exchange, key="parameter elsewhere",
            )  # fmt: skip

    def power(probe: Probe) -> None:
        before = read_parameter(probe, number)
        exchange = probe.do(command, moderate(form, 0))
        if read_parameter(probe, number) == before:
            raise Inconclusive(f"{form.name} does not change, so nothing can be lost")
        power_cycle(probe)
        after = read_parameter(probe, number)
        if after != before:
            raise Refuted(
                f"{form.name} written by 0xC1 survives the power", expected=_shown(before), got=_shown(after),
                exchange=exchange, key="parameter survives",
            )  # fmt: skip

    statement = f"{form.name} is held, answered and read as it was written."
    yield declare(
        dialect, Theme.READ_BACK, f"parameter/{form.name}/written", statement,
        "another value", written, command=command, aspect=Aspect.STATE, **needs,
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, f"parameter/{form.name}/others", f"Writing {form.name} changes no other parameter.",
        "another parameter that reads differently", others, command=command, aspect=Aspect.STATE, **needs,
    )  # fmt: skip
    yield declare(
        dialect, Theme.READ_BACK, f"parameter/{form.name}/power", f"{form.name} is as before when power comes on.",
        "the written value", power, command=command, aspect=Aspect.STATE, emulated=True, **needs,
    )  # fmt: skip


def _shown(values: dict[str, int]) -> str:
    return " ".join(f"{n} {v}" for n, v in values.items() if n != "parameter")
