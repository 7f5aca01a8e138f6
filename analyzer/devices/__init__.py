"""Files that describe the other devices of a bus: messages of CAN nodes (DBC), registers of Modbus slaves.

Each file becomes dialects of the catalogue, so that framing, pairing, schemas, filters and tables know them like drives.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from analyzer.catalogue import Dialect
from analyzer.devices.text import MOST_BYTES, Text
from analyzer.errors import UnreadableError, UsageError
from analyzer.link import EXTENDED_ID, MessageLink, ModbusSlaveLink
from analyzer.port import topic_name
from analyzer.values import identifier, printable


@dataclass(frozen=True)
class DeviceFile:
    """A file of devices. `name`: without its folder; `kind`: what it is, in words."""

    name: str
    kind: str
    sha256: str
    dialects: tuple[Dialect, ...]

    @property
    def about(self) -> dict[str, str]:
        """What the metadata of a log say of it."""
        return {f"device_file_{self.name}": f"{self.kind}, SHA-256 {self.sha256}"}


class DeviceText(msgspec.Struct, frozen=True):
    """A file of devices as it was read. `is_map`: it lists registers of Modbus slaves, else CAN messages."""

    path: str
    data: bytes
    is_map: bool = False


def load(dbc: Sequence[str], modbus_map: Sequence[str], note: Callable[[str], None]) -> list[DeviceFile]:
    """Return what some files describe. `note`: takes what a reader should know of them. Raises as `read` and `described`."""
    return described(read(dbc, modbus_map), note)


def read(dbc: Sequence[str], modbus_map: Sequence[str]) -> list[DeviceText]:
    """Return some files of devices. Raises UnreadableError for one that cannot be read."""
    return [_read(path) for path in dbc] + [_read(path, is_map=True) for path in modbus_map]


def described(texts: Sequence[DeviceText], note: Callable[[str], None]) -> list[DeviceFile]:
    """Return what files describe that were read.

    Raises UnreadableError with the place in the file for one that contradicts itself, and UsageError where two files describe
    the same.
    """
    found: list[DeviceFile] = []
    for each in texts:
        text, name = Text(each.path, each.data), _name(each.path, found)
        if each.is_map:
            from analyzer.devices.modbus_map import slaves

            found.append(_file(text, "Modbus registers", slaves(text, name, note)))
        else:
            from analyzer.devices.dbc import messages

            found.append(_file(text, "CAN messages", (messages(text, name, note),)))
    _check_apart(found)
    return found


def _file(text: Text, kind: str, dialects: tuple[Dialect, ...]) -> DeviceFile:
    return DeviceFile(printable(Path(text.path).name), kind, hashlib.sha256(text.data).hexdigest(), dialects)


def _name(path: str, before: Sequence[DeviceFile]) -> str:
    """Return the name of a file's dialects, which no dialect before it has."""
    stem, taken = topic_name(Path(path).stem), {d.name for file in before for d in file.dialects}
    return next(name for n in range(1, len(taken) + 2) if (name := stem if n == 1 else f"{stem}_{n}") not in taken)


def _read(path: str, *, is_map: bool = False) -> DeviceText:
    try:
        with Path(path).open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        raise UnreadableError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    Text(path, data)  # raises for bytes that are not text
    return DeviceText(path, data, is_map)


def _check_apart(files: Sequence[DeviceFile]) -> None:
    """Raise UsageError where two files describe one identifier or one slave."""
    owners: dict[tuple[str, int], str] = {}
    for file in files:
        for link in (dialect.link for dialect in file.dialects):
            if isinstance(link, MessageLink):
                keys = [("message", code) for code in link.codes]
            else:
                assert isinstance(link, ModbusSlaveLink)  # there are no other files
                keys = [("unit", unit) for unit in link.units]
            for what, number in keys:
                shown = identifier(number & ~EXTENDED_ID, extended=number >= EXTENDED_ID) if what == "message" else number
                other = owners.setdefault((what, number), file.name)
                if other != file.name:
                    raise UsageError(f"{what} {shown} stands in {other} and in {file.name}: expected one file for it")
