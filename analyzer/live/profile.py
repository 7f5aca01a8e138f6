"""Profiles: names for buses and drives, in a file `servotap.toml`. A name stands wherever an endpoint or a drive is asked for.

    [bus.left]                         [drive.arm]
    port = "/dev/ttyUSB0"              bus = "left"
    baud = 38400                       dialect = "mks-rs485"
    groups = [80]                      address = 1
                                       max-speed = 300

The keys are the fields of `Bus` and `Drive` below. A drive that is alone may have the keys of its bus itself. The file is
looked for in the folder, in those above it, then in the user's configuration folder; of one name in both the nearer counts.

Rules: a profile brings no permission, only what narrows one. A mistake in one entry does not keep another from being used: who
wants to stop a drive is not to be held up by the next one.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.errors import ServotapError, UsageError
from analyzer.live import endpoint as endpoints
from analyzer.live.endpoint import Endpoint
from analyzer.system.whole_file import read_whole
from analyzer.values import addresses, brief, near, printable, quote

FILE = "servotap.toml"
#: The key of a profile beside captures that says whose they are.
MACHINE = "machine"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")
#: Words that mean something else where a name may stand.
_TAKEN = frozenset({"all", "auto", "emulated", "serial", "tcp", "can"})
_KINDS = ("serial:", "tcp:", "can:")
_NAMES_SHOWN = 50
#: A key of more parts than any profile has: of each part, tomllib keeps all that stand before it, the square of their number.
_KEY_PARTS = 64
_LONG_KEY = re.compile(rf"""(?<![\w-])(?:(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_KEY_PARTS}}}""")
_WORDS = {"int": "a whole number", "float": "a number", "str": "a text", "array": "a list", "object": "a table"}


class Bus(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, rename="kebab"):
    """A bus. `port`: an endpoint, or the path of a serial port alone; `groups`: group addresses; `ids`: who is a drive."""

    port: str = ""
    baud: int | None = None
    bitrate: int | None = None
    parity: str = ""
    groups: tuple[int, ...] = ()
    ids: str = ""


class Drive(Bus, kw_only=True):
    """A drive, on a bus of the file or at a port of its own.

    Bounds as the options of their names: `max_speed` in rpm of the shaft, `max_turns`, `max_acceleration` as sent,
    `max_current` in mA. `settings`: what to put back where the drive cannot be asked, by field.
    """

    bus: str = ""
    dialect: str
    address: int = 1
    model: str = ""
    subdivision: int | None = None
    max_speed: float | None = None
    max_turns: float | None = None
    max_acceleration: float | None = None
    max_current: float | None = None
    settings: dict[str, str | int | float] = {}


class NamedDrive(NamedTuple):
    """A drive of a profile, its dialect known."""

    name: str
    dialect: Dialect
    entry: Drive

    @property
    def target(self) -> str:
        """Return DIALECT@ADDRESS."""
        return registry.drive_name(self.dialect, self.entry.address)

    @property
    def text(self) -> str:
        """Return it as `servotap test` takes a drive: with its model."""
        return self.target + (f",model={self.entry.model}" if self.entry.model else "")


class Named(NamedTuple):
    """What a name stands for. `is_drive` False: a bus with all its drives. `bus`: the bus or the drive that has the port."""

    name: str
    endpoint: Endpoint
    drives: tuple[NamedDrive, ...]
    is_drive: bool
    bus: Bus


_Entry = TypeVar("_Entry", bound=Bus)


def look_up(text: str) -> Named | None:
    """Return what a name of a profile stands for; None for a text that can be no name, as endpoints and DIALECT@ADDRESS are.

    Raises UsageError for a name that no profile has, with the near one, and for a mistake in its entry.
    """
    if not is_name(text):
        return None
    files = [_File(path) for path in paths()]
    for file in files:
        if text in file.names:
            return file.named(text)
    if not files:
        raise UsageError(f"{quote(text)} is no endpoint, and there is no {FILE} with names (servotap init ENDPOINT writes one)")
    for file in files:
        file.check_tables()
    known = [name for file in files for name in file.names]
    where = " and ".join(str(file.path) for file in files)
    raise UsageError(f"no bus or drive {quote(text)} in {where}{near(text, known)} (there are {_listed(known)})")


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    return (", ".join(names[:_NAMES_SHOWN]) or "none") + more


def is_name(text: str) -> bool:
    """Say whether a text can be a name of a profile."""
    return _NAME.fullmatch(text) is not None and text not in _TAKEN and text not in registry.names()


def endpoint(text: str) -> Endpoint:
    """Return the endpoint that a text or a name of a profile means. Raises UsageError."""
    named = look_up(text)
    return endpoints.parse(text) if named is None else named.endpoint


def drive(text: str) -> NamedDrive | None:
    """Return the one drive of a name, None for a text that is no name. Raises UsageError, also for a bus of several."""
    named = look_up(text)
    if named is None:
        return None
    if len(named.drives) != 1:
        there = ", ".join(each.name for each in named.drives) or "none in its profile"
        raise UsageError(f"{text} is a bus: which of its drives? ({there})")
    return named.drives[0]


def endpoint_texts(texts: Sequence[str]) -> tuple[list[str], list[Named]]:
    """Return endpoints with names replaced by what they stand for, each bus once, and what the names stand for."""
    found: list[str] = []
    named: list[Named] = []
    for text in texts:
        each = look_up(text)
        if each is None:
            found.append(text)
            continue
        if each.endpoint.text not in (known.endpoint.text for known in named):
            found.append(each.endpoint.text)
        named.append(each)
    return found, named


def names() -> list[str]:
    """Return the names of all profiles that can be read."""
    found: list[str] = []
    for path in paths():
        with contextlib.suppress(ServotapError):
            found += _File(path).names
    return found


def _parsed(text: str) -> dict[str, Any]:
    """Return what stands in a profile. Raises ValueError with the reason where it is none."""
    if _LONG_KEY.search(text) is not None:
        raise ValueError(f"a key has more than {_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deep for a profile") from None


def machine_of(data: bytes, where: str) -> str:
    """Return the machine that a profile names, "" where it names none. `where`: it was found. Raises UsageError."""
    try:
        name = _parsed(data.decode()).get(MACHINE, "")
    except ValueError as error:
        raise UsageError(f"{where}: expected a profile in TOML: {error}") from None
    if not isinstance(name, str) or not name.isprintable():
        raise UsageError(f'{where}: expected {MACHINE} = "a name", got {brief(name)}')
    return name


def paths() -> list[Path]:
    """Return the profiles that there are: the nearest one of this folder and those above, then the user's."""
    try:
        here = Path.cwd()
    except FileNotFoundError:
        # It was removed, and so was what stood in it.
        folders: tuple[Path, ...] = ()
    else:
        folders = (here, *here.parents)
    found = next((folder / FILE for folder in folders if _is_there(folder / FILE)), None)
    own = user_folder() / FILE
    return [*([found] if found is not None else []), *([own] if own != found and _is_there(own) else [])]


def _is_there(path: Path) -> bool:
    # A pipe of that name would be waited for.
    return path.exists() and not path.is_fifo()


def user_folder() -> Path:
    """Return the folder of the user's configuration."""
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming") / "servotap"
    usual = Path.home() / ("Library/Application Support" if sys.platform == "darwin" else ".config")
    return Path(os.environ.get("XDG_CONFIG_HOME") or usual) / "servotap"


class _File:
    """One profile. Raises UnreadableError for an unreadable file, UsageError for invalid TOML."""

    TABLES: Mapping[str, type[Bus]] = {"bus": Bus, "drive": Drive}

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._text = read_whole(path).decode()
            self._whole: dict[str, Any] = _parsed(self._text)
        except UnicodeDecodeError as error:
            raise UsageError(f"{path}: expected UTF-8, got byte {error.object[error.start]:02X} at {error.start}") from None
        except ValueError as error:
            raise UsageError(f"{path}: {str(error)[:1].lower()}{str(error)[1:]}") from None
        self._tables: dict[str, dict[str, Any]] = {
            kind: table for kind in self.TABLES if isinstance(table := self._whole.get(kind), dict)
        }
        self.names = [name for table in self._tables.values() for name in table]

    def check_tables(self) -> None:
        """Raise UsageError for a table that is none of a profile."""
        for key, value in self._whole.items():
            if key != MACHINE and (key not in self.TABLES or not isinstance(value, dict)):
                where = self._place(key, "") if isinstance(value, dict) else self._place("", key)
                raise UsageError(f"{where}: got {quote(key)}{near(key, self.TABLES)}, expected [bus.NAME] and [drive.NAME]")

    def named(self, name: str) -> Named:
        """Return what a name stands for. Raises UsageError for a mistake in its entry."""
        if all(name in self._tables.get(kind, {}) for kind in self.TABLES):
            raise UsageError(f"{self._place(f'drive.{name}', '')}: {name} is a bus, too: give one of them another name")
        if name in self._tables.get("bus", {}):
            bus = self._entry("bus", name, Bus)
            there = [
                n for n, table in self._tables.get("drive", {}).items() if isinstance(table, dict) and table.get("bus") == name
            ]
            found = self._endpoint("bus", name, bus, name)
            return Named(name, found, tuple(self._drive(n, found) for n in there), False, bus)
        entry = self._entry("drive", name, Drive)
        if not entry.bus:
            found = self._endpoint("drive", name, entry, name)
            return Named(name, found, (self._drive(name, found),), True, entry)
        if entry.port:
            raise self._error("drive", name, "port", f"got a port and bus = {quote(entry.bus)}, expected one of them")
        buses = self._tables.get("bus", {})
        if entry.bus not in buses:
            said = f"no bus {quote(entry.bus)}{near(entry.bus, buses)}, expected the name of a [bus.NAME] (there are "
            raise self._error("drive", name, "bus", f"{said}{', '.join(buses) or 'none'})")
        bus = self._entry("bus", entry.bus, Bus)
        found = self._endpoint("bus", entry.bus, bus, entry.bus)
        return Named(name, found, (self._drive(name, found),), True, bus)

    # --- one entry --------------------------------------------------------------------------------------------------

    def _entry(self, kind: str, name: str, wanted: type[_Entry]) -> _Entry:
        table = self._tables[kind][name]
        if not is_name(name):
            said = "a dialect" if name in registry.names() else "no name that can be told from other words"
            raise self._error(kind, name, "", f"{quote(name)} is {said}: expected letters, digits, _ - and ., as in arm")
        if not isinstance(table, dict):
            raise self._error(kind, name, "", f"expected a table, [{kind}.{name}], got {brief(table)}")
        known = [field.encode_name for field in msgspec.structs.fields(wanted)]
        for key in table:
            if key not in known:
                hint = (
                    "; permissions are given on the command line alone"
                    if key == "allow"
                    else near(key.replace("_", "-"), known)
                )
                raise self._error(kind, name, key, f"no key {quote(key)}{hint} (there are {', '.join(known)})")
        try:
            entry = msgspec.convert(table, wanted)
        except msgspec.ValidationError as error:
            raise self._mistake(kind, name, table, str(error)) from None
        for key, listed in (("ids", entry.ids), ("groups", ",".join(map(str, entry.groups)))):
            try:
                addresses(listed or "1", key, 0)
            except UsageError as error:
                raise self._error(kind, name, "", str(error), key) from None
        return entry

    def _mistake(self, kind: str, name: str, table: Mapping[str, Any], said: str) -> UsageError:
        """Return what msgspec says of an entry in the words of a profile."""
        missing = re.search(r"required field `([^`]+)`", said)
        if missing:
            there = f", one of {', '.join(registry.names())}" if missing[1] == "dialect" else ""
            return self._error(kind, name, "", f"no {missing[1]}, expected {missing[1]} = ...{there}")
        place = re.search(r"at `\$\.([\w-]+)", said)
        key = place[1] if place else ""
        wanted = re.match(r"Expected `([^`]+)`", said)
        words = (
            [_WORDS.get(word.strip(), word.strip()) for word in wanted[1].split("|") if word.strip() != "null"]
            if wanted
            else []
        )
        expected = f"expected {' or '.join(dict.fromkeys(words))}" if words else said
        return self._error(kind, name, key, f"{expected}, got {brief(table.get(key))}")

    def _endpoint(self, kind: str, name: str, entry: Bus, bus: str) -> Endpoint:
        if not entry.port:
            other = ' or bus = "NAME"' if kind == "drive" else ""
            raise self._error(kind, name, "", f'no port, expected port = "serial:/dev/ttyUSB0"{other}')
        text = entry.port if entry.port.startswith(_KINDS) else f"serial:{entry.port}"
        for option in ("baud", "bitrate", "parity"):
            value = getattr(entry, option)
            if value not in (None, ""):
                text += f",{option}={value}"
        try:
            return endpoints.parse(f"{bus}={text}")
        except UsageError as error:
            raise self._error(kind, name, "port", str(error)) from None

    def _drive(self, name: str, place: Endpoint) -> NamedDrive:
        entry = self._entry("drive", name, Drive)
        try:
            dialect = registry.get(entry.dialect)
            place.check_dialect(dialect)
        except UsageError as error:
            raise self._error("drive", name, "dialect", str(error)) from None
        first, last = dialect.addresses
        if not first <= entry.address <= last:
            raise self._error("drive", name, "address", f"got {entry.address}, expected {first}..{last}")
        entry.model = entry.model.upper()
        if entry.model and entry.model not in dialect.models:
            there = f"expected {' or '.join(dialect.models)}" if dialect.models else "for it has none"
            raise self._error("drive", name, "model", f"no model {quote(entry.model)} of {dialect.name}, {there}")
        if entry.subdivision is not None and not 1 <= entry.subdivision <= 256:
            raise self._error("drive", name, "subdivision", f"got {entry.subdivision}, expected 1..256")
        for bound in BOUNDS:
            value = getattr(entry, bound)
            if value is not None and not 0 < value < 1e12:
                raise self._error("drive", name, bound.replace("_", "-"), f"got {value:g}, expected a number above 0")
        return NamedDrive(name, dialect, entry)

    # --- where ------------------------------------------------------------------------------------------------------

    def _error(self, kind: str, name: str, key: str, said: str, line_of: str = "") -> UsageError:
        what = printable(f"{kind} {name}" + (f": {key}" if key else ""))
        return UsageError(f"{self._place(f'{kind}.{name}', key or line_of)}: {what}: {said}")

    def _place(self, table: str, key: str) -> str:
        """Return the file and, where it is found, the line of a key of a table; without a key, of the table."""
        inside = not table
        for number, line in enumerate(self._text.splitlines(), 1):
            header = re.fullmatch(r"\s*\[+([^\[\]]+)\]+\s*(#.*)?", line)
            if header is not None:
                here = header[1].strip().replace('"', "").replace(" ", "")
                inside = here == table or (not key and here.startswith(f"{table}."))
            if inside and (not key if header is not None else key and re.match(rf"\s*\"?{re.escape(key)}\"?\s*=", line)):
                return f"{self.path}, line {number}"
        return str(self.path)


#: Bounds of a drive by which what may be sent is narrowed, as the options name them.
BOUNDS = ("max_speed", "max_turns", "max_acceleration", "max_current")
