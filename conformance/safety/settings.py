"""The old settings of a drive, so that they can be put back: read from the drive, or given by the user in a file.

The file is JSON: field names and values as people write them, for all drives or under a drive's name:

    {"work_mode": "sr_vfoc", "current": "1600 mA"}      {"mks-rs485@1": {"work_mode": "cr_vfoc", "subdivision": 16}}
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, Risk, Verb, all_fields
from analyzer.errors import UnreadableError, UsageError
from analyzer.layout import Field
from analyzer.system.decoding import UNDECODABLE
from analyzer.system.whole_file import read_whole
from analyzer.values import near, parse_value, quote, refusal
from conformance.talk.probe import Probe

Given = Mapping[str, str]


def load(path: Path) -> dict[str, dict[str, str]]:
    """Return the values of a file by drive (empty name: all drives), as texts. Raises UnreadableError."""
    try:
        whole = msgspec.json.decode(read_whole(path), type=dict[str, Any])
    except UNDECODABLE as error:
        raise UnreadableError(f"{path}: expected a JSON object of settings, got: {error}") from None
    found: dict[str, dict[str, str]] = {}
    for name, value in whole.items():
        if isinstance(value, dict):
            found[name] = {str(n): _text(path, n, v) for n, v in value.items()}
        else:
            found.setdefault("", {})[name] = _text(path, name, value)
    every = {field for dialect in registry.every() for field in _fields(dialect)}
    for name in found.get("", {}):
        if name not in every:
            raise UnreadableError(f"{path}: no dialect has a setting {quote(name)}{near(name, every)}")
    return found


def _text(path: Path, name: str, value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise UnreadableError(f"{path}: {name}: expected a number or a text, got {value!r}")
    return str(value)


def _fields(dialect: Dialect) -> dict[str, Field]:
    """Return the fields of a dialect's settings."""
    fields: dict[str, Field] = {}
    for command in dialect.commands:
        if Risk.SETTING in command.all_risks:
            fields |= {name: f for name, f in all_fields(command.request_forms).items() if f.fixed is None}
    return fields


def known(dialect: Dialect, drive: str, given: Mapping[str, Given]) -> dict[str, int]:
    """Return what the user says that a drive's settings are, as sent, by field.

    `drive`: its name, DIALECT@ADDRESS. Raises UsageError for a name that is no setting and a value that none can have.
    """
    texts = {**given.get("", {}), **given.get(drive, {})}
    fields = _fields(dialect)
    values = {}
    for name, text in texts.items():
        field = fields.get(name)
        if field is None:
            if drive in given and name in given[drive]:
                raise UsageError(f"settings of {drive}: no setting {quote(name)}{near(name, fields)}")
            continue
        value = parse_value(field, text)
        refused = refusal(field, value)
        if refused is not None or isinstance(value, bytes):
            raise UsageError(f"settings of {drive}: {refused or name + ': expected a number'}")
        values[name] = value
    return values


#: It counts the turns anew. They are counted from about where they were afterwards, for a drive may keep within limits of
#: its position; the shaft moves meanwhile, so that it is not compared.
SET_POSITION = "set_position"
#: They move the zero or end a protection: what they change has no value that could be sent again.
_WITHOUT_VALUE = frozenset({Verb.SET_ZERO, Verb.RELEASE_PROTECTION, Verb.CLEAR_ERRORS})
#: What has a read of its own, by the command's name.
_OWN_READS = {"write_user_id": Verb.READ_USER_ID, SET_POSITION: Verb.READ_POSITION}
#: Switches that a command sets and, by another value, reads: the field, the name of that value, the field of the reply.
_SWITCHES = {Verb.BRAKE: ("brake_control", "read", "brake_state")}


def changes(command: Command) -> bool:
    """Say whether a command changes a setting that has a value: one that can be put back."""
    if command.verb in _SWITCHES:
        return True
    if command.verb in _WITHOUT_VALUE or command.slots is not None:
        return False
    return Risk.SETTING in command.all_risks and any(
        f.fixed is None for form in command.request_forms for f in form.layout.named.values()
    )


def readable(dialect: Dialect, command: Command) -> bool:
    """Say whether the drive tells what a command sets."""
    if command.verb in _SWITCHES or _OWN_READS.get(command.name) in dialect.by_verb:
        return True
    return Verb.READ_PARAMETER in dialect.by_verb and (command.readable or command.verb is Verb.WRITE_PARAMETER)


def selector(command: Command, values: Mapping[str, int]) -> int:
    """Return what tells the settings of one command apart: the parameter's number, or the command's code."""
    return int(values.get("parameter", 0)) if command.verb is Verb.WRITE_PARAMETER else command.code


def every_selector(command: Command) -> list[dict[str, int]]:
    """Return values that name each setting of a command once: one for most, one for each parameter of LK's write."""
    if command.verb is not Verb.WRITE_PARAMETER:
        return [{}]
    numbers = {f.layout.named["parameter"].fixed for f in command.request_forms if "parameter" in f.layout.named}
    return [{"parameter": number} for number in sorted(n for n in numbers if n is not None)]


def read(probe: Probe, command: Command, values: Mapping[str, int]) -> dict[str, int] | None:
    """Return what a command sets, as it is now, all fields of its request; None where the drive does not tell."""
    if command.verb in _SWITCHES:
        return _switch(probe, command)
    own = _OWN_READS.get(command.name)
    asked = {} if own else {"parameter": selector(command, values)}
    exchange = probe.ask(own or Verb.READ_PARAMETER, asked, quiet_ns=0)
    answer = exchange.reply
    if answer is None or not answer.message.frame.checksum_ok or probe.refused(exchange):
        return None
    fields = all_fields(command.request_forms)
    found = {name: int(value) for name, value in answer.values.items() if name in fields}
    if command.verb is Verb.WRITE_PARAMETER:
        return found if len(found) > 1 else None
    if len(found) < len(fields):
        return None
    unfit = command.name == SET_POSITION and refusal(fields["position"], found["position"])
    return {"position": 0} if unfit else found


def _switch(probe: Probe, command: Command) -> dict[str, int] | None:
    name, reads, told = _SWITCHES[command.verb]
    control = command.request_forms[0].layout.named[name]
    answer = probe.ask(command, {name: next(v for v, n in control.choice_names.items() if n == reads)}, quiet_ns=0).reply
    if answer is None or not answer.message.frame.checksum_ok or told not in answer.values:
        return None
    return {name: int(answer.values[told])}
