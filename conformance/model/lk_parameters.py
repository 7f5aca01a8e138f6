"""Control parameters of LK drives: the forms that list them, values to write, and how they are read.

Rules kept here:
- Values are moderate: the behaviour of a drive at the ends of their types is open.
- Some firmware lacks 0xC0 and 0xC1: a claim that meets such firmware is observed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Dialect, Form, Verb
from conformance.claim import Inconclusive, Observed

if TYPE_CHECKING:
    from conformance.talk.exchange import Exchange
    from conformance.talk.probe import Probe

OTHER_FIRMWARE = "lk-firmware-235"
#: Two values of each field that need three bytes, no two bytes alike, within what a drive may be set to.
_MODERATE = {
    "torque_limit": (600, 900),
    "speed_limit": (0x01_2345, 0x01_0F23),
    "angle_limit": (0x2134_5678, 0x1134_5678),
    "current_ramp": (0x01_2345, 0x02_1436),
    "speed_ramp": (0x06_1234, 0x05_2143),
}
#: The limit of the angle, and what it must leave to the suite: five turns, in hundredths of a degree.
_ANGLE, _ROOM = "angle_limit", 180_000
_GAINS = {"kp": (0x0164, 0x0232), "ki": (0x0119, 0x0226), "kd": (0x0102, 0x0203)}


def number_of(form: Form) -> int:
    """Return the number of the parameter that a form is about, 0 for the form of all others."""
    return form.layout.named["parameter"].fixed or 0


def listed(command: Command) -> list[Form]:
    """Return the forms of a parameter write that are about one parameter."""
    return [f for f in command.request_forms if number_of(f)]


def listed_in(dialect: Dialect) -> list[Form]:
    """Return the forms of all parameters that a dialect lists."""
    return listed(dialect.by_verb[Verb.WRITE_PARAMETER])


def moderate(form: Form, which: int) -> dict[str, int]:
    """Return the first or second set of moderate values of a parameter."""
    values = {}
    for name, field in form.layout.named.items():
        if field.fixed is not None:
            values[name] = field.fixed
        else:
            values[name] = (_MODERATE.get(name) or _GAINS[name.rpartition("_")[2]])[which]
    return values


def read_parameter(probe: Probe, number: int) -> dict[str, int]:
    """Return a control parameter.

    Raises Observed where the firmware does not have the command, Inconclusive where it answers for another parameter.
    """
    exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": number})
    if exchange.silent and OTHER_FIRMWARE in probe.claim.quirks:
        probe.meets(OTHER_FIRMWARE)
        raise Observed("control parameters cannot be read: as firmware 2.35 was seen to be")
    values = {n: int(v) for n, v in probe.reply(exchange).values.items()}
    if values.get("parameter") != number:
        raise Inconclusive(f"a read of parameter {number} is answered for {values.get('parameter')}")
    return values


def parameter(probe: Probe, name: str) -> int | None:
    """Return a parameter by its field, None where the drive has none and the claim knows of such firmware."""
    exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": _number(probe, name)})
    if exchange.silent and OTHER_FIRMWARE in probe.claim.quirks:
        probe.meets(OTHER_FIRMWARE)
        return None
    values = probe.reply(exchange).values
    if name not in values:
        raise Inconclusive(f"the drive does not answer with its {name}")
    return int(values[name])


def set_parameter(probe: Probe, name: str, value: int) -> Exchange:
    """Write a parameter of one field. Raises Inconclusive where the drive refuses."""
    return probe.do(Verb.WRITE_PARAMETER, {"parameter": _number(probe, name), name: value})


def _number(probe: Probe, name: str) -> int:
    return next(number_of(form) for form in listed_in(probe.dialect) if name in form.layout.named)


def need_room(probe: Probe) -> None:
    """Raise Inconclusive where a drive's own limit of the angle lies within the moves of the suite."""
    command = probe.dialect.by_verb.get(Verb.WRITE_PARAMETER)
    for form in listed(command) if command is not None else ():
        if _ANGLE in form.layout.named:
            answer = probe.ask(Verb.READ_PARAMETER, {"parameter": number_of(form)}).reply
            held = int(answer.values.get(_ANGLE, 0)) if answer is not None else 0
            if 0 < abs(held) < _ROOM:
                raise Inconclusive(f"the drive's own {_ANGLE} is {held}: set it to {_ROOM} or more")
