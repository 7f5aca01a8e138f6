"""Makes drives from their names.

    mks-rs485@1    mks-rs485@2,model=57D,quirk=stale-status    lk-rs485@3,fault=late-reply,baud=38400,real=bench

    DIALECT@ADDRESS[,model=M][,quirk=NAME...][,fault=NAME...][,real=bench|poor][,TRAIT=VALUE...][,baud=N][,SETTING=VALUE...]

A setting is named as its field, or as its command without `set_` where that has one field: `work_mode=5`,
`work_mode=sr_vfoc`, `direction=ccw`. Values are as people write them, in the unit of the field. `baud` (`bitrate` on CAN)
is the drive's speed in bits per second in every dialect.

`KINDS` alone names the class of each dialect.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.layout import Field
from analyzer.values import near, parse_value, quote, refusal
from conformance.drives import realism
from conformance.drives.drive import Drive, Fault, Quirk
from conformance.drives.realism import Realism


class DriveClass(NamedTuple):
    """Where the drive of a dialect is: its module and its class."""

    module: str
    drive: str


KINDS: Mapping[str, DriveClass] = {
    "mks-rs485": DriveClass("conformance.drives.mks.drive", "MksDrive"),
    "mks-modbus": DriveClass("conformance.drives.mks.drive", "MksDrive"),
    "mks-can": DriveClass("conformance.drives.mks.drive", "MksDrive"),
    "lk-rs485": DriveClass("conformance.drives.lk.drive", "LkDrive"),
}
#: The modules of faults and of quirks. Names are unique over all of them.
FAULTS = (
    "conformance.drives.faults.generic",
    "conformance.drives.faults.mks",
    "conformance.drives.faults.mks_hearing",
    "conformance.drives.faults.mks_conditions",
    "conformance.drives.faults.mks_sequences",
    "conformance.drives.faults.mks_effects",
    "conformance.drives.faults.lk",
    "conformance.drives.faults.lk_motion",
    "conformance.drives.faults.lk_conditions",
)
QUIRKS = ("conformance.drives.mks.quirks", "conformance.drives.lk.quirks")
#: Words of a specification that are no settings.
_WORDS = ("model", "quirk", "fault", "baud", "bitrate")
#: Settings that the name of a drive already says.
_ADDRESS = frozenset({"address", "new_address"})


@dataclass(frozen=True)
class Specification:
    """A drive as it was named. `settings` and `speed` are as written; `name` is how it is known in files and logs."""

    dialect: Dialect
    address: int
    model: str = ""
    quirks: tuple[Quirk, ...] = ()
    faults: tuple[Fault, ...] = ()
    settings: tuple[tuple[str, str], ...] = ()
    speed: int | None = None
    realism: Realism | None = None

    @property
    def name(self) -> str:
        """DIALECT@ADDRESS."""
        return f"{self.dialect.name}@{self.address}"


# --- faults and quirks ------------------------------------------------------------------------------------------------


def every_fault() -> list[Fault]:
    """Return all faults of all dialects, each once."""
    return [fault for name in FAULTS for fault in import_module(name).FAULTS]


def every_quirk() -> list[Quirk]:
    """Return all quirks of all dialects, each once."""
    return [quirk for name in QUIRKS for quirk in import_module(name).QUIRKS]


_Change = TypeVar("_Change", Quirk, Fault)


def _find(changes: Sequence[_Change], what: str, name: str, dialect: str) -> _Change:
    """Return the fault or quirk of a name; the family in front of a name (`lk-`) can be left out."""
    word = name.strip().lower().replace("_", "-")
    family = dialect.partition("-")[0]
    own = {c.name: c for c in reversed(changes) if dialect in c.dialects}
    found = own.get(word) or own.get(f"{family}-{word}")
    if found is not None:
        return found
    elsewhere = sorted({d for c in changes if c.name == word for d in c.dialects})
    if elsewhere:
        raise UsageError(f"{dialect} has no {what} {quote(name)}: it belongs to {', '.join(elsewhere)}")
    hint = near(word, own) or near(f"{family}-{word}", own)
    raise UsageError(f"{dialect} has no {what} {quote(name)}{hint} (see servotap emulate --list-{what}s)")


# --- specifications ---------------------------------------------------------------------------------------------------


def parse(text: str) -> Specification:
    """Return what `DIALECT@ADDRESS[,...]` says.

    Raises UsageError, with the nearest names, for what does not exist.
    """
    head, *parts = text.split(",")
    name, at, number = head.partition("@")
    if not at:
        raise UsageError(f"got {quote(text)}, expected DIALECT@ADDRESS, as in mks-rs485@1")
    dialect = registry.get(name.strip())
    if dialect.name not in KINDS:
        raise UsageError(f"no emulated drive speaks {dialect.name} (there are {', '.join(KINDS)})")
    found: dict[str, list[str]] = {}
    settings, real = [], []
    for part in parts:
        word, equals, value = part.partition("=")
        word = word.strip()
        if word == "real" or word.replace("_", "-") in realism.BY_NAME:
            real.append((word.replace("_", "-"), value.strip()))
            continue
        if not equals or not word or not value.strip():
            raise UsageError(f"{head}: got {quote(part)}, expected NAME=VALUE, as in model={_example(dialect)}")
        if word in _WORDS:
            found.setdefault(word, []).append(value.strip())
        else:
            settings.append((word, value.strip()))
    model = found.get("model", [""])[-1].upper()
    if model and model not in dialect.models:
        raise UsageError(f"{head}: no model {quote(model)}, expected {' or '.join(dialect.models)}")
    return Specification(
        dialect,
        _address(dialect, head, number),
        model,
        tuple(_find(every_quirk(), "quirk", n, dialect.name) for n in found.get("quirk", ())),
        tuple(_find(every_fault(), "fault", n, dialect.name) for n in found.get("fault", ())),
        tuple(settings),
        _speed(dialect, head, found),
        realism.parse(head, real),
    )


def _example(dialect: Dialect) -> str:
    return dialect.models[0] if dialect.models else "M"


def _address(dialect: Dialect, head: str, number: str) -> int:
    first, last = dialect.addresses
    try:
        address = int(number, 0)
    except ValueError:
        address = -1
    if not first <= address <= last:
        raise UsageError(f"{head}: got the address {quote(number)}, expected {first}..{last}")
    return address


def _speed(dialect: Dialect, head: str, found: Mapping[str, Sequence[str]]) -> int | None:
    word = "bitrate" if dialect.bus == "can" else "baud"
    other = "baud" if word == "bitrate" else "bitrate"
    if other in found:
        raise UsageError(f"{head}: got {other}, expected {word}: {dialect.name} is a dialect of {dialect.bus} buses")
    if word not in found:
        return None
    text = found[word][-1]
    speed = int(text) if text.isdecimal() else 0
    if speed not in dialect.baud_rates:
        known = ", ".join(str(rate) for rate in sorted(dialect.baud_rates))
        raise UsageError(f"{head}: got {word} {quote(text)}, expected one of {known}")
    return speed


# --- settings ---------------------------------------------------------------------------------------------------------


class Settings:
    """What the settings of one kind of drive are called and may be. `held`: all of them at their defaults."""

    def __init__(self, drive: Drive) -> None:
        self.dialect = dialect = drive.dialect
        self.held = held = dict(drive.settings)
        self._speed = drive.speed_setting
        self._fields: dict[str, Field] = {}
        self._by_command: dict[str, str] = {}
        for command in dialect.commands:
            names = []
            for form in command.request_forms:
                for name, field in form.layout.named.items():
                    if name in held and field.fixed is None:
                        self._fields.setdefault(name, field)
                        names.append(name)
            if command.name.startswith("set_") and len(set(names)) == 1:
                self._by_command.setdefault(command.name.removeprefix("set_"), names[0])

    @property
    def names(self) -> list[str]:
        """All names that a setting can be given by."""
        return sorted({*self.held, *self._by_command} - _ADDRESS)

    def find(self, name: str) -> str | None:
        """Return the setting that a name means, None where there is none."""
        word = name.strip().lower().replace("-", "_")
        if word not in self.held:
            word = word.removeprefix("set_")
        if word in _ADDRESS:
            raise UsageError(f"{name}: the address of a drive stands in its name, as in {self.dialect.name}@1")
        return word if word in self.held else self._by_command.get(word)

    def value(self, name: str, text: str) -> int:
        """Return the value of a setting as sent.

        Raises UsageError for one that it cannot have.
        """
        speeds = {speed: code for code, speed in self.dialect.rates.items()} if name == self._speed else {}
        if text.isdecimal() and int(text) in speeds and self.held[name] in speeds.values():
            return speeds[int(text)]
        field = self._fields.get(name)
        if field is None:
            try:
                return int(text, 0)
            except ValueError:
                raise UsageError(f"{name}: got {quote(text)}, expected a whole number") from None
        value = parse_value(field, text)
        refused = refusal(field, value)
        if refused is not None or isinstance(value, bytes):
            raise UsageError(refused or f"{name}: got bytes, expected a number")
        return value

    def text(self, name: str, value: int) -> str:
        """Return a value as sent as `value` reads it."""
        field = self._fields.get(name)
        return str(value if field is None else field.physical(value))

    def of_speed(self, speed: int) -> dict[str, int]:
        """Return the setting that makes the drive listen at a speed."""
        return {self._speed: self.value(self._speed, str(speed))} if self._speed in self.held else {}


def parse_settings(texts: Iterable[str]) -> list[tuple[str, str]]:
    """Return names and values of `NAME=VALUE` texts.

    Raises UsageError for what is not one.
    """
    pairs = []
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise UsageError(f"got {quote(text)}, expected NAME=VALUE, as in work_mode=5")
        pairs.append((name.strip(), value.strip()))
    return pairs


# --- drives -----------------------------------------------------------------------------------------------------------


def make(
    specification: Specification, *, settings: Mapping[str, int] | None = None, seed: int = 0, reply_delay_ns: int | None = None
) -> Drive:
    """Return the drive of a specification.

    `settings`: as sent, by field name; the specification's own win over them. `reply_delay_ns`: what a drive without a
    fault takes to answer, in place of its own time. Raises UsageError for a setting that the drive does not have.
    """
    given = settings_of(specification, settings or {})
    changes: dict[str, Any] = {"quirks": specification.quirks, "faults": specification.faults, "realism": specification.realism}
    drive = _made(specification, settings=given, seed=seed, **changes)
    if reply_delay_ns is not None:
        changed_ns = drive.reply_delay_ns - plain_drive(specification.dialect.name, specification.model).reply_delay_ns
        drive.reply_delay_ns = max(0, reply_delay_ns + changed_ns)
    return drive


def settings_of(specification: Specification, settings: Mapping[str, int]) -> dict[str, int]:
    """Return what the drive of a specification holds that was said of it, as sent, by field; its own win over `settings`.

    Raises UsageError for a setting that the drive does not have.
    """
    names = plain_drive(specification.dialect.name, specification.model).settings
    given = dict(settings)
    if specification.speed is not None:
        given |= names.of_speed(specification.speed)
    for word, text in specification.settings:
        name = names.find(word)
        if name is None:
            known = near(word, [*names.names, *_WORDS, "real", *realism.BY_NAME])
            raise UsageError(f"{specification.name} has no setting {quote(word)}{known}")
        given[name] = names.value(name, text)
    return given


class Plain(NamedTuple):
    """A drive of a kind with nothing special about it."""

    settings: Settings
    reply_delay_ns: int


@cache
def plain_drive(dialect: str, model: str = "") -> Plain:
    """Return what a drive of a dialect and model is when nothing is said of it."""
    drive = _made(Specification(registry.get(dialect), 1, model))
    return Plain(Settings(drive), drive.reply_delay_ns)


def _made(specification: Specification, **options: Any) -> Drive:
    kind = KINDS[specification.dialect.name]
    made: Drive = getattr(import_module(kind.module), kind.drive)(
        specification.dialect, specification.address, model=specification.model, **options
    )
    return made


def start_settings(specifications: Sequence[Specification], pairs: Sequence[tuple[str, str]]) -> list[dict[str, int]]:
    """Return start settings for each drive: of `pairs` those that its dialect has.

    Raises UsageError for a setting that no drive has, and for a value that a drive that has it cannot take.
    """
    every = [plain_drive(s.dialect.name, s.model).settings for s in specifications]
    result: list[dict[str, int]] = [{} for _ in specifications]
    for word, text in pairs:
        found = False
        for names, given in zip(every, result, strict=True):
            name = names.find(word)
            if name is not None:
                given[name] = names.value(name, text)
                found = True
        if not found:
            known = {n for names in every for n in names.names}
            raise UsageError(f"no drive here has a setting {quote(word)}{near(word, known)}")
    return result
