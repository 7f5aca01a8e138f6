"""What an MKS drive keeps: the settings in its flash, and what is lost with the power.

Rules kept here:
- A setting has the name of its field in the catalogue and the default printed there; where the manual prints none, the
  one of `UNPRINTED`, else 0.
- Besides the settings, `KEPT` names what other commands leave in the flash.
- `Memory` is what a restart clears: whatever stands in it is gone, and nothing else is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from analyzer.catalogue import Command, Dialect, Verb
from analyzer.layout import Field
from conformance.drives.mks.paths import Number

#: Defaults that the manual of the RS485 drives does not print: the home speed is that of the CAN drives.
UNPRINTED: Mapping[str, int] = {"home_speed": 60}

#: What is stored by other commands than settings, and its default.
KEPT: Mapping[str, int] = {
    "saved_run": 0,  # whether a run at a speed is kept for power-on (FF)
    "saved_direction": 0,
    "saved_speed": 0,
    "saved_acceleration": 0,
    "zero_kept": 0,  # whether a zero point is kept (9A), and where it is within the turn
    "zero_point": 0,
    "limits_homed": 0,  # whether homing was done since the end limits were changed
}

#: Where each setting stands that the catalogue has under no "set" command.
_ALSO = frozenset({Verb.WRITE_USER_ID})


def is_setting(command: Command) -> bool:
    """Say whether the fields of a command's request are stored."""
    return command.verb in _ALSO or (command.verb.value.startswith("set_") and command.verb is not Verb.SET_ZERO)


class Catalogued(NamedTuple):
    """What a dialect says of settings: their fields by name, and the default of everything that a drive keeps."""

    fields: Mapping[str, Field]
    defaults: Mapping[str, int]


def catalogued(dialect: Dialect) -> Catalogued:
    """Return what a dialect says of settings; worked out once, and kept with it.

    A dialect without a model has the defaults of its first one.
    """
    kept: Catalogued | None = dialect.__dict__.get("_catalogued")
    if kept is None:
        resolved = dialect if dialect.model else dialect.for_model(dialect.models[0])
        defaults = dict(KEPT)
        for name, field in _fields(resolved).items():
            defaults[name] = UNPRINTED.get(name, 0) if field.default is None else int(field.default)
        kept = dialect.__dict__["_catalogued"] = Catalogued(_fields(dialect), defaults)
    return kept


def _fields(dialect: Dialect) -> dict[str, Field]:
    fields: dict[str, Field] = {}
    for command in dialect.commands:
        if is_setting(command):
            for form in command.request_forms:
                for name, field in form.layout.named.items():
                    fields.setdefault(name, field)
    return fields


@dataclass
class Memory:
    """What a drive forgets when it restarts.

    `zero`: the encoder's zero, and `pulse_zero` where the count of pulses is 0, both in counts of the shaft. `run`: the
    last run at a speed (direction, speed, acceleration as sent). The ports (CAN): masks and levels as written.
    """

    enabled: bool = True
    protected: bool = False
    zero: Number = 0
    pulse_zero: Number = 0
    run: tuple[int, int, int] | None = None
    zero_status: int = 1
    alm_mask: int = 0
    pend_mask: int = 0
    alm: int = 0
    pend: int = 0
