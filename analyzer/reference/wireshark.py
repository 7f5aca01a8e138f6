"""The dialects as a dissector for Wireshark: their tables as Lua, in front of the engine `wireshark.lua`.

Each field of a layout is a field of Wireshark, `servotap.mks_can.read_speed.speed`, in its unit. A field that request and reply
declare alike is one; else that of the reply is `servotap.mks_can.write_io.reply.status`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from analyzer import __version__
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.layout import Field, FieldKind, Order
from analyzer.link import CanLink, HeadLink, LkLink, ModbusLink
from analyzer.reference.objects import concerns
from analyzer.values import range_text

_ENGINE = "wireshark.lua"
#: Where the tables go in the engine.
_PLACE = "--[[ tables ]]"


def dissector(dialects: Iterable[Dialect]) -> str:
    """Return the Lua file for some dialects. Raises ValueError for a dialect whose link is none of ours."""
    engine = files(__package__).joinpath(_ENGINE).read_text(encoding="utf-8")
    tables = [_dialect(each) for each in dialects]
    text = f"local version = {_lua(__version__)}\nlocal dialects = {_lua(tables)}"
    return engine.replace(_PLACE, text)


def _dialect(dialect: Dialect) -> dict[str, Any]:
    fields: list[dict[str, Any]] = []
    commands = [_command(dialect, command, fields) for command in dialect.commands]
    fallbacks = {function: _command(dialect, command, fields) for function, command in dialect.fallbacks.items()}
    exception = None
    if dialect.exception is not None:
        exception = _form(dialect.exception, _numbers(fields, dialect, "exception", [dialect.exception], [])[0])
    return {
        "name": dialect.name,
        "title": dialect.title,
        "addresses": dialect.addresses,
        "broadcast": dialect.broadcast,
        **_link(dialect),
        "commands": commands,
        "fallbacks": fallbacks,
        "exception": exception,
        "fields": fields,
    }


def _link(dialect: Dialect) -> dict[str, Any]:
    link = dialect.link
    if type(link) is HeadLink:
        package = None if link.package is None else {"head": link.package.head, "length": link.package.length}
        return {"kind": "head", "heads": {head: role.value for head, role in link.heads.items()}, "package": package}
    if type(link) is LkLink:
        return {"kind": "lk"}
    if type(link) is ModbusLink:
        return {"kind": "modbus", "odd_counts": dict(link.odd_counts)}
    if type(link) is CanLink:
        return {"kind": "can"}
    raise ValueError(f"{dialect.name}: a link of its own ({type(link).__name__}), which the dissector does not know")


def _command(dialect: Dialect, command: Command, fields: list[dict[str, Any]]) -> dict[str, Any]:
    numbers = _numbers(fields, dialect, command.name, command.request_forms, command.reply_forms)
    replies = command.replies
    errata = [f"{e.section}: {e.printed} - {e.wrong}; taken as: {e.taken_as}" for e in dialect.errata if concerns(e, command)]
    return {
        "name": command.name,
        "code": command.code,
        "func": command.function,
        "section": command.section,
        "summary": command.summary,
        "errata": errata,
        "moves": command.moves,
        "status": replies.status,
        "interim": dict.fromkeys(replies.interim, True),
        "failed": dict.fromkeys(replies.failed, True),
        "failed_forms": dict.fromkeys(replies.failed_forms, True),
        "silenced": command.silenced,
        "effects": {effect.value: name for effect, name in command.effects.items()},
        "changes": command.changes_answers,
        "slots": None if command.slots is None else {"count": command.slots.count, "size": command.slots.size},
        "request": [_form(form, numbers[0]) for form in command.request_forms],
        "reply": [_form(form, numbers[1]) for form in command.reply_forms],
    }


def _numbers(
    fields: list[dict[str, Any]], dialect: Dialect, name: str, requests: Sequence[Form], replies: Sequence[Form]
) -> tuple[dict[str, int], dict[str, int]]:
    """Declare the fields of a command's forms, and return the number of each by its name: in requests, in replies."""
    found: tuple[dict[str, int], dict[str, int]] = ({}, {})
    place = f"servotap.{dialect.name.replace('-', '_')}.{name}"
    declared: dict[str, dict[str, Any]] = {}
    for numbers, forms, role in zip(found, (requests, replies), Role, strict=False):
        for form in forms:
            for each in form.layout.fields:
                if each.kind is FieldKind.RESERVED or each.name in numbers:
                    continue
                path = f"{place}.{each.name}"
                about = _declared(each)
                if declared.get(path, about) != about:
                    path = f"{place}.{role}.{each.name}"
                if path not in declared:
                    declared[path] = about
                    fields.append({"path": path, **about})
                numbers[each.name] = 1 + next(i for i, f in enumerate(fields) if f["path"] == path)
    return found


def _declared(field: Field) -> dict[str, Any]:
    """Return what Wireshark has to know of a field to declare it."""
    if field.kind is FieldKind.BYTES:
        kind = "bytes"
    elif field.scale != 1:
        kind = "double"
    else:
        kind = ("int" if field.kind is FieldKind.INT else "uint") + ("64" if field.bit_width > 32 else "32")
    return {"name": field.name, "type": kind, "unit": field.unit, "choices": dict(field.choice_names) or None}


def _form(form: Form, numbers: Mapping[str, int]) -> dict[str, Any]:
    return {
        "name": form.name,
        "code": form.code,
        "needs": form.needs_request,
        "wanted": dict(form.request_values or {}) or None,
        "size": form.layout.byte_length,
        "open": form.layout.open_ended,
        "fields": [_field(offset, field, numbers) for offset, field in form.layout],
    }


def _field(offset: int, field: Field, numbers: Mapping[str, int]) -> dict[str, Any]:
    if field.kind is FieldKind.RESERVED:
        return {"offset": offset, "width": field.bit_width, "reserved": True}
    limited = field.low > field.wire_minimum or field.high < field.wire_maximum
    return {
        "offset": offset,
        "width": field.bit_width,
        "signed": field.kind is FieldKind.INT,
        "little": field.order is Order.LITTLE,
        "up": field.scale.numerator,
        "down": field.scale.denominator,
        "number": numbers[field.name],
        "fixed": field.fixed,
        "low": field.low if limited else None,
        "high": field.high if limited else None,
        "range": range_text(field) if limited else None,
        "listed": dict.fromkeys(field.values, True) if field.values is not None else None,
    }


def _lua(value: object) -> str:
    """Return a value as Lua text; None and False are left out of tables, where they say the same."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        return '"' + "".join(_escaped(character) for character in value) + '"'
    if isinstance(value, Mapping):
        pairs = (f"{_key(k)}={_lua(v)}" for k, v in value.items() if v is not None and v is not False)
        return "{" + ",".join(pairs) + "}"
    if isinstance(value, Sequence):
        return "{" + ",\n".join(_lua(each) for each in value) + "}"
    raise TypeError(f"no Lua for {value!r}")


def _key(key: object) -> str:
    return key if isinstance(key, str) and key.isidentifier() else f"[{_lua(key)}]"


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    return character if character.isprintable() else "".join(f"\\{byte:03d}" for byte in character.encode())
