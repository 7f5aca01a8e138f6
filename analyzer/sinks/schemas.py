"""JSON Schemas of the log's topics, made from the layouts.

Rules (Foxglove's): the root is an object; no null, no anyOf, no lists of types; a field that may be absent is not
required. A choice is two fields, the number and its name. Reserved keys begin with `_`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from analyzer import events
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.codec import shown
from analyzer.layout import NOT_NUMERIC, STATE_UNITS, Field, FieldKind

_RESERVED: dict[str, dict[str, Any]] = {
    "_raw": {"type": "string", "description": "bytes of the frame, hex"},
    "_checksum_ok": {"type": "boolean"},
    "_offset": {"type": "integer", "description": "bytes of this bus before the frame"},
    "_backward_ns": {"type": "integer", "unit": "ns", "description": "its own time lies so far before log_time"},
    "_findings": {"type": "array", "items": {"type": "string"}, "description": "rules broken, as far as known here"},
}
_REPLY: dict[str, dict[str, Any]] = {
    "_latency": {"type": "number", "description": "from the end of the request to the start of the reply", "unit": "s"},
    "_request_sequence": {"type": "integer", "description": "sequence of the request's message"},
}
_CAN: dict[str, dict[str, Any]] = {
    "_can_id": {"type": "integer"},
    "_can_flags": {"type": "array", "items": {"type": "string"}},
    "_direction": {"type": "string", "description": "who sent it, where that was marked"},
}


def field_properties(field: Field, section: str) -> dict[str, dict[str, Any]]:
    """Return the schema properties of a field: itself, its name twin, its text twin."""
    if field.kind is FieldKind.BYTES:
        return {field.name: {"type": "string", "description": "bytes, hex"}}
    words = [field.note] if field.note else []
    if field.kind in NOT_NUMERIC:
        of_items = {"items": {"type": "integer"}} if field.kind is FieldKind.NUMBERS else {}
        return {field.name: {"type": "array" if of_items else "string", **of_items, "description": "; ".join(words)}}
    if field.unit:
        words.append(f"unit {field.unit}")
    if field.fixed is None and field.choices is None and field.kind is not FieldKind.NUMBER:
        words.append(f"range {shown(field.physical(field.low))}..{shown(field.physical(field.high))}")
    if section:
        words.append(f"section {section}")
    whole = field.scale == 1 and field.kind is not FieldKind.NUMBER
    own: dict[str, Any] = {"type": "integer" if whole else "number", "description": "; ".join(words)}
    if field.unit:
        own["unit"] = field.unit
    result = {field.name: own}
    if field.choices is not None:
        names = ", ".join(f"{v} {n}" for v, n in sorted(field.choice_names.items())[:24])
        result[field.name + "_name"] = {"type": "string", "description": names}
    if field.has_text_twin:
        result[field.name + "_text"] = {"type": "string", "description": "the exact value, beyond 2**53"}
    return result


def forms_of(dialect: Dialect, command: Command, role: Role) -> tuple[Form, ...]:
    """Return every form that a message of a command can have, those of the dialect as a whole included."""
    forms = command.reply_forms if role is Role.REPLY else command.request_forms
    fallback = dialect.fallbacks.get(command.function) if command.function is not None else None
    if fallback is not None and fallback is not command:
        forms += fallback.reply_forms if role is Role.REPLY else fallback.request_forms
    if dialect.exception is not None and role is Role.REPLY:
        forms += (dialect.exception,)
    return forms


def command_schema(dialect: Dialect, command: Command, role: Role) -> bytes:
    """Return the JSON Schema of a command's requests or replies."""
    properties: dict[str, Any] = {}
    for form in forms_of(dialect, command, role):
        for name, field in form.layout.named.items():
            if name not in properties:
                properties.update(field_properties(field, command.section))
    if command.slots is not None:
        properties = {"slots": slots_property(dialect)}
    return _object(
        f"{dialect.title}: {command.summary}" + (f" (section {command.section})" if command.section else ""),
        {**properties, **_RESERVED, **(_REPLY if role is Role.REPLY else {}), **(_CAN if dialect.bus == "can" else {})},
    )


def slots_property(dialect: Dialect) -> dict[str, Any]:
    """Return the property of a package's slots: a list of address, command and that command's fields."""
    properties: dict[str, Any] = {
        "address": {"type": "integer"},
        "code": {"type": "integer"},
        "command": {"type": "string"},
        "raw": {"type": "string"},
    }
    for command in dialect.commands:
        if command.slots is None:
            for form in command.request_forms:
                for field in form.layout.named.values():
                    if field.name not in properties:
                        properties.update(field_properties(field, command.section))
    return {"type": "array", "items": {"type": "object", "properties": properties}}


def state_schema() -> bytes:
    """Return the schema of the derived state of a drive."""
    return _object(
        "State of a drive, from all frames that carry it; the same units for every dialect",
        {name: {"type": "number", "unit": unit, "description": f"unit {unit}"} for name, unit in STATE_UNITS.items()},
    )


def unknown_schema() -> bytes:
    """Return the schema of frames that no command fits or whose sender is not known."""
    words = {"dialect": {"type": "string"}, "command": {"type": "string"}, "role": {"type": "string"}}
    return _object("Frames without a command", {"address": {"type": "integer"}, **words, **_RESERVED, **_CAN})


def foreign_schema() -> bytes:
    """Return the schema of frames of nodes that are no drives."""
    who = {"type": "string", "description": "on CAN the identifier in hexadecimal, else the address"}
    size = {"type": "integer", "description": "data bytes"}
    own = {name: _RESERVED[name] for name in ("_raw", "_offset", "_backward_ns")}
    return _object(
        "Frames that are not of this dialect", {"address": {"type": "integer"}, "who": who, "length": size, **own, **_CAN}
    )


def junk_schema() -> bytes:
    """Return the schema of bytes that belong to no frame."""
    return _object(
        "Bytes that belong to no frame",
        {"reason": {"type": "string"}, "length": {"type": "integer"}, "_raw": _RESERVED["_raw"]}
        | {name: _RESERVED[name] for name in ("_offset", "_backward_ns")},
    )


def stats_schema() -> bytes:
    """Return the schema of a bus's counts per second."""
    whole = {"type": "integer"}
    return _object(
        "Counts of one second of a bus",
        {"frames": whole, "bytes": whole, "junk_bytes": whole, "errors": whole, "warnings": whole}
        | {"load": {"type": "number", "description": "share of the second in which bytes were on the wire"}},
    )


def raw_schema() -> bytes:
    """Return the schema of what came, as it came."""
    return _object(
        "Bytes as they came, or a CAN frame",
        {"_raw": _RESERVED["_raw"], "_offset": _RESERVED["_offset"], **_CAN}
        | {"_silence": {"type": "boolean", "description": "no bytes: nothing more belongs to what came before"}},
    )


#: How the values of events stand in a schema, by their type.
_OF_TYPES: tuple[tuple[Any, dict[str, Any]], ...] = (
    (str, {"type": "string"}),
    (events.Nanoseconds, {"type": "integer"}),
    (events.BusKind, {"type": "string"}),
    (events.Whole, {"type": "integer"}),
    (events.Seconds, {"type": "number", "unit": "s", "description": "unit s"}),
    (events.Moment, {"type": "string", "description": "UTC"}),
    (list[str], {"type": "array", "items": {"type": "string"}}),
    (list[events.Whole], {"type": "array", "items": {"type": "integer"}}),
)
_EVENT: dict[str, dict[str, Any]] = {
    name: next(schema for known, schema in _OF_TYPES if known == kind) for name, kind in events.TYPES.items()
}
_KINDS: dict[str, type | tuple[type, ...]] = {
    "string": str, "integer": int, "number": (int, float), "array": (list, tuple),
}  # fmt: skip


def event_schema() -> bytes:
    """Return the schema of what happened to a recording."""
    text = {"type": "string"}
    details = {"type": "string", "description": "further values, as JSON"}
    return _object("What happened to the recording", {"event": text, "bus": text, "text": text, **_EVENT, "details": details})


def event_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of an event as its schema has them; those that do not fit it as one text."""
    known: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, value in values.items():
        if name == "text":
            continue  # it stands beside them
        if name == "details" and isinstance(value, Mapping):
            others |= value
            continue
        wanted = _EVENT.get(name)
        fits = wanted is not None and isinstance(value, _KINDS[wanted["type"]]) and not isinstance(value, bool)
        (known if fits else others)[name] = value
    if others:
        known["details"] = msgspec.json.encode(others).decode()
    return known


def log_schema() -> bytes:
    """Return the schema of `foxglove.Log`, with what leads to the place as further fields."""
    stamp = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
    text, whole = {"type": "string"}, {"type": "integer"}
    return _object(
        "foxglove.Log",
        {
            "timestamp": stamp,
            "level": {"type": "integer", "description": "1 debug, 2 info, 3 warning, 4 error"},
            "message": text,
            "name": {**text, "description": "rule"},
            "file": {**text, "description": "topic of the message it is about"},
            "line": {**whole, "description": "sequence of that message"},
            "section": text,
            "bus": text,
            "address": whole,
            "offset": whole,
        },
    )


def _object(title: str, properties: dict[str, Any]) -> bytes:
    return msgspec.json.encode({"title": title, "type": "object", "properties": properties})
