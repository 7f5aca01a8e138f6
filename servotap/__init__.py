"""Servotap from Python: captures as records and data frames, frames explained, drives emulated or real.

    import servotap

    capture = servotap.open("bench.log")
    capture.to_pandas(fields="speed")
    capture.plot("speed", "position")

    print(servotap.explain("FA 01 F6 01 40 02 34"))

    with servotap.drive("mks-rs485@1") as drive:
        drive.read("read_speed")

What stands in `__all__` is public; `analyzer` and `conformance` below it may change. Nothing is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Any

from analyzer import __version__

if TYPE_CHECKING:
    from analyzer.errors import ServotapError, UnreadableError, UsageError
    from analyzer.records import Finding, Junk
    from conformance.claim import NotStopped
    from conformance.gate.gate import Refused
    from conformance.suite.preflight import DriveNotFound
    from servotap.captures import Capture, Frame, Transaction
    from servotap.drives import Drive, NotDone, Reply
    from servotap.explained import Explained
    from servotap.lakes import Lake

__all__ = [
    "Capture",
    "Drive",
    "DriveNotFound",
    "Explained",
    "Finding",
    "Frame",
    "Junk",
    "Lake",
    "NotDone",
    "NotStopped",
    "Refused",
    "Reply",
    "ServotapError",
    "Transaction",
    "UnreadableError",
    "UsageError",
    "__version__",
    "drive",
    "explain",
    "lake",
    "open",
]

#: Where each public class is, for those who name it.
_HOMES = {
    "Capture": "servotap.captures",
    "Drive": "servotap.drives",
    "DriveNotFound": "conformance.suite.preflight",
    "Explained": "servotap.explained",
    "Finding": "analyzer.records",
    "Frame": "servotap.captures",
    "Junk": "analyzer.records",
    "Lake": "servotap.lakes",
    "NotDone": "servotap.drives",
    "NotStopped": "conformance.claim",
    "Refused": "conformance.gate.gate",
    "Reply": "servotap.drives",
    "ServotapError": "analyzer.errors",
    "Transaction": "servotap.captures",
    "UnreadableError": "analyzer.errors",
    "UsageError": "analyzer.errors",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


def open(
    path: str | PathLike[str],
    *,
    dialect: str = "auto",
    model: str | None = None,
    baud: int | None = None,
    format: str | None = None,
    channels: Sequence[str] = (),
    inverted: bool = False,
    uart: str = "",
    groups: Collection[int] = (),
    ids: str = "",
    dbc: Collection[str | PathLike[str]] = (),
    modbus_map: Collection[str | PathLike[str]] = (),
    since: str | None = None,
    until: str | None = None,
) -> Capture:
    """Open a capture of any format, a log, or a folder of parts.

    `dialect`, `model`, `ids`, `since` and `until` as for `servotap show`; `channels`, `inverted` and `uart` (`8E1`) of a logic
    analyzer; `dbc`, `modbus_map`: files that describe the other devices of the bus. Raises UnreadableError, UsageError.
    """
    from servotap.captures import Capture

    return Capture(
        path, dialect=dialect, model=model, baud=baud, format=format, channels=channels, inverted=inverted, uart=uart,
        groups=groups, ids=ids, dbc=dbc, modbus_map=modbus_map, since=since, until=until,
    )  # fmt: skip


def explain(
    frame: str | bytes,
    *,
    dialect: str | None = None,
    role: str | None = None,
    model: str | None = None,
    request: str | bytes | None = None,
    no_checksum: bool = False,
) -> Explained:
    """Explain a frame byte by byte: hex as `servotap explain` takes it, or the bytes themselves.

    `request`: what this frame answers. Raises UnreadableError where no dialect reads it.
    """
    from servotap.explained import explained

    return explained(frame, dialect=dialect, role=role, model=model, request=request, no_checksum=no_checksum)


def lake(url: str | PathLike[str], **store: Any) -> Lake:
    """Open a lake that `servotap ingest` made: a folder, or a URL. `store`: options of fsspec, as `endpoint_url`.

    Raises UnreadableError for a place without a lake, UsageError for a store that cannot be used.
    """
    from servotap.lakes import Lake

    return Lake(url, store)


def drive(
    name: str,
    on: str = "",
    *,
    allow: Collection[str] = (),
    max_speed: float | None = None,
    max_turns: float | None = None,
    max_acceleration: float | None = None,
    max_current: float | None = None,
    subdivision: int | None = None,
    alone: bool = False,
    max_run: float = 30.0,
    cut_power: str = "",
    timeout: float = 1.0,
    log: str | PathLike[str] | None = None,
    replace_log: bool = False,
) -> Drive:
    """Connect to a drive: an emulated one, a real one at an endpoint (`serial:/dev/ttyUSB0,baud=38400`), or one of a profile.

    Only reads and stops are sent, besides what is allowed here or with each command; bounds as for `servotap send`. A guard
    process owns a real port. It stops the drive if this program dies, and a run without an end after `max_run` seconds.
    `timeout`: of a reply, in seconds. `log`: a file for all that is sent and comes, which `servotap.open` reads.
    Raises UsageError; DriveNotFound where a real drive does not answer.
    """
    from servotap.drives import Drive

    return Drive(
        name,
        on,
        allow=allow,
        max_speed=max_speed,
        max_turns=max_turns,
        max_acceleration=max_acceleration,
        max_current=max_current,
        subdivision=subdivision,
        alone=alone,
        max_run=max_run,
        cut_power=cut_power,
        timeout=timeout,
        log=log,
        replace_log=replace_log,
    )
