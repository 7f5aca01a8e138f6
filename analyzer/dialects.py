"""Which dialects there are, and which of their commands a name or a code means.

Dialects are those of this package, and those that other packages add by an entry point.

An entry point stands in the group `servotap.dialects` and names a `Dialect` object. Nothing else is needed: framing,
decoding, logging, `explain` and the reference pages follow from the declaration.

A command is found by its name, its code (`0xF6`, `F6`) or its register (`0x0030`, `04:0030`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from importlib import import_module

from analyzer import plugins
from analyzer.catalogue import Command, Dialect
from analyzer.errors import UsageError
from analyzer.link import Link, guarded
from analyzer.values import near, quote

#: Dialects of this package: name -> module with a `DIALECT`.
_OWN = {
    "mks-rs485": "analyzer.protocols.mks_rs485",
    "mks-modbus": "analyzer.protocols.mks_modbus",
    "mks-can": "analyzer.protocols.mks_can",
    "lk-rs485": "analyzer.protocols.lk_rs485",
}
#: Those of this package that are of no drive. Nothing that acts on a bus uses them.
_OF_NO_DRIVE = {"modbus": "analyzer.protocols.modbus_slave"}
GROUP = "servotap.dialects"
_CODE = re.compile(r"(?:(?:0x)?([0-9a-f]{1,2})[:/])?(?:0x)?([0-9a-f]{1,4})h?", re.IGNORECASE)


@cache
def _added() -> dict[str, Dialect]:
    result: dict[str, Dialect] = {}
    for name, found in plugins.loaded(GROUP):
        what = f"{name} of {GROUP}"
        dialect = plugins.attempt(what, partial(_as_dialect, what, found))
        if dialect is not None:
            result[dialect.name] = dialect
    return result


def _as_dialect(what: str, found: object) -> Dialect:
    if not isinstance(found, Dialect):
        raise UsageError(f"expected a Dialect, got {type(found).__name__}")
    if found.name in _OWN or found.name in _OF_NO_DRIVE:
        raise UsageError(f"the name {found.name} is taken: expected another one")
    if not isinstance(found.link, Link):
        raise UsageError(f"{found.name}: expected a Link, got {type(found.link).__name__}")
    return replace(found, link=guarded(what, found.link))


def names() -> list[str]:
    """Return the names of all dialects of drives."""
    return [*_OWN, *sorted(_added())]


def readable() -> list[str]:
    """Return the names of all dialects that traffic can be read as."""
    return [*names(), *_OF_NO_DRIVE]


@cache
def get(name: str) -> Dialect:
    """Return a dialect by name.

    Raises UsageError for a name there is none of, with the nearest one.
    """
    own = (_OWN | _OF_NO_DRIVE).get(name)
    if own is not None:
        dialect: Dialect = import_module(own).DIALECT
        return dialect
    if name in _added():
        return _added()[name]
    raise UsageError(f"no dialect {name!r}{near(name, readable(), 1)} (there are {', '.join(readable())})")


def drive(text: str) -> tuple[Dialect, int]:
    """Return the dialect and the address that `DIALECT@ADDRESS` names.

    Raises UsageError for a dialect or an address there is not.
    """
    name, at, number = text.partition("@")
    if not at:
        raise UsageError(f"got {quote(text)}, expected DIALECT@ADDRESS, as in mks-rs485@1")
    dialect = get(name.strip())
    first, last = dialect.addresses
    try:
        address = int(number, 0)
    except ValueError:
        address = -1
    if not first <= address <= last:
        highest = f"{last} (0x{last:X})" if dialect.bus == "can" else str(last)
        raise UsageError(f"{text}: got the address {quote(number)}, expected {first}..{highest}")
    return dialect, address


def drive_name(dialect: Dialect, address: int) -> str:
    """Return the name of a drive, as `drive` takes it: on CAN its identifier in hexadecimal."""
    return f"{dialect.name}@0x{address:X}" if dialect.bus == "can" and address > 9 else f"{dialect.name}@{address}"


def of_drive(named: str) -> Dialect:
    """Return the dialect of a drive that a run has named, `DIALECT@ADDRESS[,model=M]...`, for its model. Raises UsageError."""
    head, *parts = named.split(",")
    model = next((part.removeprefix("model=") for part in parts if part.startswith("model=")), "")
    return for_model([get(head.partition("@")[0])], model)[0]


def every() -> list[Dialect]:
    """Return all dialects of drives, without those that have failed and are left out."""
    return [dialect for dialect in map(get, names()) if not dialect.link.left_out]


def asked_for(name: str | None, model: str | None) -> list[Dialect]:
    """Return the dialects that a user asks for: one, those that know the model, or all. Raises UsageError."""
    adapted = for_model([get(name)] if name else every(), model)
    return [d for d in adapted if d.model] if model else adapted


def of_no_drive() -> list[Dialect]:
    """Return the dialects that a capture may turn out to be in where no drive speaks."""
    return [get(name) for name in _OF_NO_DRIVE]


def first_bytes() -> frozenset[int]:
    """Return the bytes that begin a frame of some dialect, those aside whose frames can begin with any byte."""
    return frozenset().union(*(dialect.link.first_bytes for dialect in every()))


def for_model(dialects: Sequence[Dialect], model: str | None) -> list[Dialect]:
    """Return the dialects as a model speaks them; of several (`42D,MG`) each as the only one that it knows.

    Those that know none, or several, stay as they are. Raises UsageError for a model that none of them has.
    """
    if not model:
        return list(dialects)
    wanted = [each.strip().upper() for each in model.split(",")]
    for each in wanted:
        if not any(each in d.models for d in dialects):
            known = sorted({m for d in dialects for m in d.models})
            raise UsageError(f"no model {each!r} in {', '.join(d.name for d in dialects)}; there are {', '.join(known)}")
    fitting = {d.name: [each for each in wanted if each in d.models] for d in dialects}
    return [d.for_model(fitting[d.name][0]) if len(fitting[d.name]) == 1 else d for d in dialects]


def by_name(model: str = "") -> dict[str, Dialect]:
    """Return every dialect of drives by its name, as a model speaks it. Raises UsageError for an unknown model."""
    return {d.name: d for d in for_model(every(), model or None)}


def readable_by_name(devices: Sequence[Dialect], model: str = "") -> dict[str, Dialect]:
    """Return every dialect that may come up in traffic, by its name. `devices`: those of files; `model`: as the user says."""
    return {d.name: d for d in (*devices, *by_name(model).values(), *of_no_drive())}


# --- commands -----------------------------------------------------------------------------------------------------------


def code_text(code: int, function: int | None = None) -> str:
    """Return a code as the manuals write it: two digits, four for the register of a function."""
    return f"0x{code:02X}" if function is None else f"0x{code:04X}"


def find_commands(dialects: Sequence[Dialect], text: str) -> list[tuple[Dialect, Command]]:
    """Return the commands of a name or code, in the order of the dialects and their manuals.

    A code of up to two digits means function codes, one of more digits registers, unless there is none of that kind.
    Raises UsageError, with the nearest names, where there is none.
    """
    word = text.strip().lower().replace("-", "_").replace(" ", "_")
    pairs = [(d, c) for d in dialects for c in d.commands]
    found = [(d, c) for d, c in pairs if c.name == word]
    if found:
        return found
    match = _CODE.fullmatch(text.strip())
    if match is not None:
        code = int(match[2], 16)
        found = [(d, c) for d, c in pairs if c.code == code]
        if match[1] is not None:
            return _some([(d, c) for d, c in found if c.function == int(match[1], 16)], dialects, text)
        wide = len(match[2]) > 2
        return _some([(d, c) for d, c in found if (c.function is not None) == wide] or found, dialects, text)
    return _some([], dialects, text)


def search_commands(dialects: Sequence[Dialect], text: str) -> tuple[list[tuple[Dialect, Command]], bool]:
    """Return the commands of a name, a code, a section or a word. The flag says that a section or a word found them.

    Raises UsageError, with the nearest names, where there is none.
    """
    try:
        return find_commands(dialects, text), False
    except UsageError:
        word = text.strip().lower().replace("_", " ").replace("-", " ")
        pairs = [(d, c) for d in dialects for c in d.commands]
        found = [(d, c) for d, c in pairs if c.section == word or c.section.startswith(f"{word}.")]
        found = found or [(d, c) for d, c in pairs if word in c.name.replace("_", " ") or word in c.summary.lower()]
        if not found or not word:
            raise
        return found, True


def _some(found: list[tuple[Dialect, Command]], dialects: Sequence[Dialect], text: str) -> list[tuple[Dialect, Command]]:
    if found:
        return found
    known = sorted({c.name for d in dialects for c in d.commands})
    where = dialects[0].name if len(dialects) == 1 else "no dialect"
    told = f"{where} has no command {quote(text)}" if len(dialects) == 1 else f"{where} has a command {quote(text)}"
    raise UsageError(told + near(text.replace("-", "_"), known))


def find_command(dialect: Dialect, text: str) -> Command:
    """Return the one command of a dialect that a name or code means.

    Raises UsageError where there is none, or where a code means several.
    """
    found = find_commands([dialect], text)
    if len(found) > 1:
        names = " or ".join(c.name for _, c in found)
        raise UsageError(f"{dialect.name}: {quote(text)} is the code of several commands, expected {names}")
    return found[0][1]
