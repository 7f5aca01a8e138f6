"""Finding commands by what people type: a name, a code (`0xF6`, `F6`), a register (`0x0030`, `04:0030`)."""

from __future__ import annotations

import re
from collections.abc import Sequence

from analyzer.catalogue import Command, Dialect
from analyzer.errors import UsageError
from analyzer.values import near, quote

_CODE = re.compile(r"(?:(?:0x)?([0-9a-f]{1,2})[:/])?(?:0x)?([0-9a-f]{1,4})h?", re.IGNORECASE)


def code_text(code: int, function: int | None = None) -> str:
    """Return a code as the manuals write it: two digits, four for the register of a function."""
    return f"0x{code:02X}" if function is None else f"0x{code:04X}"


def find(dialects: Sequence[Dialect], text: str) -> list[tuple[Dialect, Command]]:
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


def _some(found: list[tuple[Dialect, Command]], dialects: Sequence[Dialect], text: str) -> list[tuple[Dialect, Command]]:
    if found:
        return found
    known = sorted({c.name for d in dialects for c in d.commands})
    where = dialects[0].name if len(dialects) == 1 else "no dialect"
    told = f"{where} has no command {quote(text)}" if len(dialects) == 1 else f"{where} has a command {quote(text)}"
    raise UsageError(told + near(text.replace("-", "_"), known))


def find_one(dialect: Dialect, text: str) -> Command:
    """Return the one command of a dialect that a name or code means.

    Raises UsageError where there is none, or where a code means several.
    """
    found = find([dialect], text)
    if len(found) > 1:
        names = " or ".join(c.name for _, c in found)
        raise UsageError(f"{dialect.name}: {quote(text)} is the code of several commands, expected {names}")
    return found[0][1]
