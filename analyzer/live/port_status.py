"""The status of each port of a recording, from the events of its reader: for the display and the final summary.

It counts what was lost or may have been, and remembers the first gaps with their times. Memory is bounded.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import msgspec

from analyzer.values import counted

#: Gaps, and notes, that are remembered for each port; further ones are counted.
REMEMBERED = 100
#: Counters of the kernel that mean lost bytes; the others mean garbled ones.
LOSING = frozenset({"overrun", "buf_overrun"})


class Gap(msgspec.Struct, omit_defaults=True):
    """A time in which a port was not read. `to_ns`: None while it lasts; `kept`: nothing was lost, the kernel held it."""

    from_ns: int
    to_ns: int | None
    reason: str
    kept: bool = False


class PortStatus(msgspec.Struct, omit_defaults=True):
    """What happened to one port.

    `state`: `opening`, `listening`, `lost` or `closed`. `count`: bytes or frames, by `unit`, as the reader counted them
    last; `records`: chunks or frames stored. `dropped`: what came in and could not be stored. `kernel_dropped`: frames.
    """

    bus: str
    endpoint: str
    state: str = "opening"
    unit: str = "bytes"
    count: int | None = None
    records: int = 0
    precision: str = ""
    notes: list[str] = []
    gaps: list[Gap] = []
    gap_count: int = 0
    counters: dict[str, int] = {}
    dropped: int = 0
    kernel_dropped: int = 0
    bus_errors: dict[str, int] = {}
    restarts: int = 0

    @property
    def lost(self) -> bool:
        """Whether traffic was lost, or may have been."""
        gaps = any(not gap.kept for gap in self.gaps) or self.gap_count > len(self.gaps)
        return bool(gaps or self.dropped or self.kernel_dropped or self.counters.keys() & LOSING)


def take(port: PortStatus, event: Mapping[str, Any]) -> str:
    """Update a port's status by an event; return its text for a viewer, or nothing."""
    handler = _HANDLERS.get(str(event.get("event")))
    return handler(port, event) if handler is not None else ""


def _open(port: PortStatus, event: Mapping[str, Any]) -> str:
    port.state = "listening"
    port.precision = str(event.get("precision", ""))
    return "; ".join(_notes(port, event))


def _notes(port: PortStatus, event: Mapping[str, Any]) -> list[str]:
    """Remember the notes of an event; return those that are new."""
    new = [str(note) for note in event.get("notes", ()) if note not in port.notes]
    port.notes += new[: max(0, REMEMBERED - len(port.notes))]
    return new


def _note(port: PortStatus, event: Mapping[str, Any]) -> str:
    if event.get("kept"):
        port.state = "listening"
        from_ns = int(event["from_ns"])
        _remember(port, Gap(from_ns, from_ns + int(event["gap_ns"]), "its reader process died", kept=True))
    return str(event["text"])


def _remember(port: PortStatus, gap: Gap) -> None:
    port.gap_count += 1
    if len(port.gaps) < REMEMBERED:
        port.gaps.append(gap)


def _lost(port: PortStatus, event: Mapping[str, Any]) -> str:
    port.state = "lost"
    _remember(port, Gap(int(event["t_ns"]), None, str(event["reason"])))
    return f"lost: {event['reason']}; retrying"


def _back(port: PortStatus, event: Mapping[str, Any]) -> str:
    # A reader that died could not tell that the port was lost.
    if port.state != "lost":
        _remember(port, Gap(int(event["from_ns"]), None, "its reader process died"))
    port.state = "listening"
    if port.gaps and port.gaps[-1].to_ns is None:
        port.gaps[-1].to_ns = int(event["t_ns"])
    return "; ".join([f"back after {int(event['gap_ns']) / 1e9:.3f} s", *_notes(port, event)])


def _overrun(port: PortStatus, event: Mapping[str, Any]) -> str:
    risen = {k: int(v) for k, v in event.items() if isinstance(v, int) and k not in ("t_ns", "from_ns")}
    port.counters = dict(Counter(port.counters) + Counter(risen))
    return ", ".join(counted(n, noun) + where for name, n in risen.items() for noun, where in [_COUNTED.get(name, (name, ""))])


#: Counters of the kernel: what each counts, and where or why.
_COUNTED = {
    "overrun": ("byte", " lost in the adapter (overrun)"),
    "buf_overrun": ("byte", " lost in the kernel (buffer full)"),
    "frame": ("framing error", " (wrong baud rate?)"),
    "parity": ("parity error", ""),
    "brk": ("break", ""),
}


def _dropped(port: PortStatus, event: Mapping[str, Any]) -> str:
    count = int(event.get("bytes", event.get("frames", 0)))
    port.dropped += count
    return f"{counted(count, port.unit[:-1])} lost, could not be stored: {event['reason']}"


def _kernel_dropped(port: PortStatus, event: Mapping[str, Any]) -> str:
    port.kernel_dropped += int(event["frames"])
    return f"{counted(event['frames'], 'frame')} lost in the kernel (buffer full)"


def _bus_error(port: PortStatus, event: Mapping[str, Any]) -> str:
    reason = str(event["reason"])
    known = reason in port.bus_errors or len(port.bus_errors) < REMEMBERED
    port.bus_errors[reason if known else "others"] = port.bus_errors.get(reason if known else "others", 0) + int(event["count"])
    return reason


def _count(port: PortStatus, event: Mapping[str, Any]) -> str:
    port.count = int(event.get(port.unit, 0))
    return ""


def _closed(port: PortStatus, event: Mapping[str, Any]) -> str:
    port.state = "closed"
    port.records += int(event.get("records", 0))
    port.count = int(event.get(port.unit, 0))
    return ""


_HANDLERS = {
    "failed": lambda port, event: str(event["reason"]),
    "open": _open,
    "note": _note,
    "speed": lambda port, event: str(event["text"]),
    "lost": _lost,
    "back": _back,
    "overrun": _overrun,
    "kernel_dropped": _kernel_dropped,
    "bus_error": _bus_error,
    "dropped": _dropped,
    "unstored": _dropped,
    "count": _count,
    "closed": _closed,
}
