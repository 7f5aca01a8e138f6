"""Targets: the drives under test as a user names them, and where they are.

    mks-rs485@1,model=57D    on serial:/dev/ttyUSB0,baud=38400
    mks-can@0x12             on can:socketcan:can0,bitrate=500000
    mks-rs485@1,fault=late-reply    on emulated

A drive on hardware has an address and perhaps a model, and any dialect there is; an emulated one can have all that
`servotap emulate` takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.live.endpoint import DEFAULT_BAUD, DEFAULT_BITRATE, Endpoint
from analyzer.live.profile import NamedDrive
from analyzer.values import quote
from conformance.bus import at_default_rate
from conformance.drives import make
from conformance.drives.make import Specification

EMULATED = "emulated"


@dataclass(frozen=True)
class Target:
    """One drive under test. `text` as named; `endpoint` None: emulated, and `specification` says which drive.

    `named`: what a profile says of it.
    """

    text: str
    dialect: Dialect
    address: int
    model: str
    endpoint: Endpoint | None
    specification: Specification | None
    named: NamedDrive | None = None

    @property
    def emulated(self) -> bool:
        """Whether no real bus is used."""
        return self.endpoint is None

    @property
    def on(self) -> str:
        """Where it is, as named."""
        return EMULATED if self.endpoint is None else self.endpoint.text

    @property
    def rate(self) -> int:
        """Bits per second of its line, the usual one of a new drive where it is emulated."""
        if self.endpoint is not None:
            return self.endpoint.bits_per_second
        return DEFAULT_BITRATE if self.dialect.bus == "can" else DEFAULT_BAUD

    @property
    def port(self) -> str:
        """What drives on one wire have in common: tests on them cannot run at the same time."""
        return f"{self.text}" if self.endpoint is None else f"{self.endpoint.kind}:{self.endpoint.place}"


def every_emulated() -> list[Target]:
    """Return emulated drives of all dialects, so that each command is had by one: what is tested where nothing is said."""
    return [
        parse(f"{name}@1" + (f",model={model}" if model else ""), EMULATED)
        for name in make.KINDS
        for model in telling_models(registry.get(name))
    ]


def telling_models(dialect: Dialect) -> list[str]:
    """Return as few models of a dialect as have all its commands between them; one empty name where there are none."""
    chosen = list(dialect.models[:1]) or [""]
    for command in dialect.commands:
        if command.models and not set(command.models) & set(chosen):
            chosen.append(command.models[0])
    return chosen


def parse_all(drives: Sequence[str], places: Sequence[str]) -> list[Target]:
    """Return the targets of `--drive` and `--on`: one place for all drives, or one for each in their order.

    A name of a profile is a drive, or all drives of a bus, and brings its place. Raises UsageError for what does not fit
    together.
    """
    if not drives and places and all(profile.is_name(place) for place in places):
        drives, places = places, []
    if not drives:
        if any(place != EMULATED for place in places):
            raise UsageError(f"which drive is on {places[0]}? expected --drive DIALECT@ADDRESS, as in --drive mks-rs485@1")
        return every_emulated()
    where = list(places) or [EMULATED]
    if len(where) == 1:
        where *= len(drives)
    if len(where) != len(drives):
        raise UsageError(f"got {len(drives)} drives and {len(where)} places: give one --on for all drives or one for each")
    pairs = zip(drives, where if places else [""] * len(drives), strict=True)
    targets = [target for drive, place in pairs for target in _of_one(drive, place)]
    for index, target in enumerate(targets):
        for other in targets[:index]:
            same = target.port == other.port and target.address == other.address and target.dialect.bus == other.dialect.bus
            if same and not (target.emulated and target.text != other.text):
                raise UsageError(f"{target.text} on {target.on} stands there twice")
    return targets


def _of_one(drive: str, place: str) -> list[Target]:
    """Return what one word names: a drive, or the drives of a profile; `place`: as given, else empty."""
    named = profile.look_up(drive)
    if named is None:
        return [parse(drive, place or EMULATED)]
    if not named.drives:
        raise UsageError(f"{drive} is a bus without drives: add a [drive.NAME] with bus = {quote(drive)} to {profile.FILE}")
    return [replace(parse(each.text, place or named.endpoint.text), named=each) for each in named.drives]


def one(drive: str, place: str = "") -> Target:
    """Return the one target that a drive and a place name; without a place, the one of the profile, else emulated."""
    found = parse_all([drive], [place] if place else [])
    if len(found) != 1:
        raise UsageError(f"{drive} is a bus of several drives: name one of them")
    return found[0]


def any_real(drives: Sequence[str], places: Sequence[str]) -> bool:
    """Say whether a drive that is named is no emulated one. Raises UsageError for what is none."""
    return any(not target.emulated for target in parse_all(drives, places))


def parse(drive: str, place: str = EMULATED) -> Target:
    """Return the target that a drive and a place name. Raises UsageError that says what was expected."""
    if place == EMULATED:
        text = drive if "@" in drive else _with_address(drive)
        specification = make.parse(text)
        return Target(text, specification.dialect, specification.address, specification.model, None, specification)
    endpoint = profile.endpoint(place)
    head, *parts = drive.split(",")
    name, at, _ = head.partition("@")
    if not at:
        raise UsageError(f"{quote(drive)} on {place}: which address? expected DIALECT@ADDRESS, as in {name}@1")
    options = dict(_option(drive, part) for part in parts)
    strange = [word for word in options if word != "model"]
    if strange:
        raise UsageError(f"{quote(drive)}: a drive on hardware has no {strange[0]}, expected model=M (--on emulated has more)")
    dialect, address = registry.drive(head)
    model = options.get("model", "").upper()
    if model and model not in dialect.models:
        known = f"expected {' or '.join(dialect.models)}" if dialect.models else "for it has none"
        raise UsageError(f"{head}: no model {quote(model)}, {known}")
    if dialect.bus != endpoint.bus_kind:
        raise UsageError(f"{head} is a drive on {dialect.bus}, and {place} is a {endpoint.bus_kind} bus")
    return Target(drive, dialect, address, model, at_default_rate(endpoint, dialect), None)


def _option(drive: str, part: str) -> tuple[str, str]:
    name, equals, value = part.partition("=")
    if not equals or not value:
        raise UsageError(f"{quote(drive)}: got {quote(part)}, expected model=M")
    return name.strip(), value


def _with_address(drive: str) -> str:
    head, comma, rest = drive.partition(",")
    registry.get(head)
    return f"{head}@1{comma}{rest}"
