"""Servotap from Python: captures as records and data frames, frames explained, drives emulated or real.

    import servotap

    capture = servotap.open("bench.log")
    capture.to_pandas(fields="speed")
    capture.plot("speed", "position")

    print(servotap.explain("FA 01 F6 01 40 02 34"))

    with servotap.drive("mks-rs485@1") as drive:
        drive.read("read_speed")

What stands in `__all__` is public; `analyzer` and `conformance` below it may change. Nothing is loaded before it is used.
`open`, `drive` and `lake` are `Capture`, `Drive` and `Lake` by the names of what one does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from analyzer import __version__

if TYPE_CHECKING:
    from analyzer.errors import ServotapError, UnreadableError, UsageError
    from analyzer.records import Finding, Junk
    from conformance.claim import NotStopped
    from conformance.gate.gate import Refused
    from conformance.suite.preflight import DriveNotFound
    from servotap.captures import Capture, Frame, Transaction
    from servotap.captures import Capture as open
    from servotap.drives import Drive, NotDone, Reply
    from servotap.drives import Drive as drive
    from servotap.explained import Explained, explain
    from servotap.lakes import Lake
    from servotap.lakes import Lake as lake

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

#: The module of each public name, and its name there if that is another one.
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
    "drive": "servotap.drives:Drive",
    "explain": "servotap.explained",
    "lake": "servotap.lakes:Lake",
    "open": "servotap.captures:Capture",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, there = _HOMES[name].partition(":")
    return getattr(import_module(module), there or name)


def __dir__() -> list[str]:
    return sorted(__all__)
