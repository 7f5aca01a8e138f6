"""A plain, harmless, valid request for every command: what a claim sends that only needs some request.

    sample(dialect, command)            the values of its first form, integers as sent
    sample(dialect, command, form)      those of another form

Rules kept here:
- Every value is one that the manual allows. Where a value says how something moves, it is small and slow: 60 rpm at 16
  subdivisions and less than a turn, whatever the subdivision, by a gentle ramp.
- A setting is given its default; an address is the one that the drive has; a baud rate the default. What has a harmless
  value (read a brake, forget a kept run, enable) has that.
- A command that is harmful with any values (calibrate, restore) is so here too: its risks say so, the gate judges.

A move to a place (not by a distance) goes to zero: it is small where zero was set before, and at most a turn where the
place is one within the turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analyzer.catalogue import Command, Dialect, Form
from analyzer.layout import Field, FieldKind

#: Integers as sent by field name, for fields whose default says nothing or would do something.
PLAIN: Mapping[str, int] = {
    "acceleration": 200,
    "pulses": 160,  # a twentieth of a turn at 16 subdivisions
    "enabled": 1,
    "execute": 1,
    "respond": 1,
    "active": 1,
    "group_address": 0x50,
    "save_state": 0xCA,  # forget the kept run
    "home_speed": 60,
    "current": 800,
    "home_current": 400,
    "brake_control": 0x10,  # read
    "torque_current": 0,
    "power": 0,
    "angle": 0,
    "speed_limit": 36_000,
    "torque_limit": 500,
    "angle_limit": 36_000_000,
    "current_ramp": 100_000,
    "speed_ramp": 360_000,
}
#: The same, by the unit of the field, where a field of one name means different things.
PLAIN_BY_UNIT: Mapping[tuple[str, str], int] = {
    ("speed", "rpm"): 60,
    ("speed", "deg/s"): 6_000,
    ("max_speed", "deg/s"): 6_000,
    ("position", "counts"): 800,
    ("position", "pulses"): 160,
    ("position", "deg"): 1_000,
}
#: Commands that go to a place: their position is the zero.
_TO_A_PLACE = frozenset(
    {"move_absolute_pulses", "move_absolute_axis", "move_multi_turn", "move_multi_turn_limited", "set_position"}
)
#: The form that is plain, where it is not the first.
_FORMS: Mapping[str, str] = {"write_parameter": "speed_limit"}


def plain_form(command: Command) -> Form:
    """Return the form of a request that is plain: the first, for most commands."""
    wanted = _FORMS.get(command.name)
    return next((f for f in command.request_forms if f.name == wanted), command.request_forms[0])


def sample(dialect: Dialect, command: Command | str, form: Form | None = None, *, address: int = 1) -> dict[str, Any]:
    """Return the values of a plain request, integers as sent, by field name.

    `form`: one of the command's; the plain one by default. `address`: of the drive, which a change of address gives it
    again. A package holds one slot, a read of that drive's speed.
    """
    if isinstance(command, str):
        command = dialect.by_name[command]
    if command.slots is not None:
        return {"slots": [{"address": address, "command": "read_speed"}]}
    chosen = form or plain_form(command)
    values = {name: plain_value(field) for name, field in chosen.layout.named.items()}
    if command.name in _TO_A_PLACE and "position" in values:
        values["position"] = 0
    if "new_address" in values:
        values["new_address"] = address
    return values


def plain_value(field: Field) -> int:
    """Return a plain value of a field that the manual allows, as sent."""
    if field.fixed is not None:
        return field.fixed
    if field.kind is FieldKind.BYTES:
        raise ValueError(f"{field.name}: there is no plain value of any number of bytes")
    named = PLAIN.get(field.name, PLAIN_BY_UNIT.get((field.name, field.unit)))
    candidates = (named, field.default, 0, field.low, *sorted(field.values or field.choice_names))
    return next(int(c) for c in candidates if c is not None and field.allows(int(c)))
