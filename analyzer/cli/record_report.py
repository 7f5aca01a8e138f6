"""How a recording ended: what was recorded, what was lost, where it is. As an object, and as text."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from analyzer.cli.option_types import duration_text, size_text
from analyzer.live.port_status import LOSING, PortStatus
from analyzer.live.snapshot import FOREIGN, Snapshot
from analyzer.live.supervisor import Supervisor
from analyzer.reference.columns import columns
from analyzer.values import counted, printable

#: Gaps of a port that the text names; the object has them all.
_GAPS_NAMED = 10
#: Nodes that the text names of those that are no drives; the object has them all.
_OTHERS_NAMED = 12


class Summary(msgspec.Struct, kw_only=True):
    """The end of a recording. `buses`: counts of the decoding by bus; `lost`: whether anything was."""

    reason: str
    seconds: float
    ports: list[PortStatus]
    buses: dict[str, dict[str, Any]]
    rules: dict[str, int]
    #: The lines of each cause of trouble, by its id.
    causes: dict[str, list[str]]
    #: Who else spoke: frames by bus and identifier or address, those with the most first.
    others: dict[str, dict[str, int]]
    files: list[str]
    bytes: int
    decoder_restarts: int
    unfinished: str
    lost: bool
    #: UTC of monotonic 0, for the times of gaps.
    utc_ns: int


def summarize(supervisor: Supervisor) -> Summary:
    """Return how a recording ended."""
    config, snapshot = supervisor.config, supervisor.snapshot
    files = [str(path) for path in supervisor.files]
    ports = list(supervisor.tallies.values())
    buses = {} if snapshot is None else {b.bus: msgspec.to_builtins(b) for b in snapshot.buses}
    return Summary(
        reason=supervisor.reason,
        seconds=(supervisor.ended_ns - supervisor.began_ns) / 1e9,
        ports=ports,
        buses=buses,
        rules={} if snapshot is None else dict(sorted(snapshot.rules.items(), key=lambda item: -item[1])),
        causes={} if snapshot is None else snapshot.causes,
        others=_others_of(snapshot),
        files=files,
        bytes=sum(Path(name).stat().st_size for name in files),
        decoder_restarts=supervisor.decoder_restarts,
        unfinished=supervisor.unfinished,
        lost=bool(supervisor.unfinished) or any(port.lost or _missing(port, ports, buses) for port in ports),
        utc_ns=config.utc_ns(0),
    )


def as_text(summary: Summary) -> list[str]:
    """Return the lines that tell the end."""
    lines = [f"recorded {duration_text(int(summary.seconds * 1e9))} ({summary.reason})"]
    rows = [("bus", "", "in", "frames", "junk", "lost", "")]
    for port in summary.ports:
        counts = summary.buses.get(port.bus, {})
        count = "?" if port.count is None else f"{port.count} {port.unit}"
        rows.append(
            (
                port.bus, port.endpoint, count, str(counts.get("frames", "")), str(counts.get("junk_bytes", 0) or ""),
                _lost(port, _missing(port, summary.ports, summary.buses)), _garbled(port),
            )
        )  # fmt: skip
    lines += [printable(line) for line in columns(rows)]
    lines += [printable(_others(bus, counts)) for bus, counts in summary.others.items()]
    for port in summary.ports:
        lines += _gaps(port, summary.utc_ns)
    if summary.rules:
        lines.append("findings: " + ", ".join(f"{count} {rule}" for rule, count in summary.rules.items()))
    elif any(summary.buses.values()):
        lines.append("no findings")
    lines += [printable(line) for cause in summary.causes.values() for line in cause]
    if summary.decoder_restarts:
        lines.append(f"the decoding process was started again {counted(summary.decoder_restarts, 'time')}; no data was lost")
    for name in summary.files:
        lines.append(f"wrote {printable(name)}, {size_text(Path(name).stat().st_size)}")
    if summary.unfinished:
        lines.append(summary.unfinished)
    return lines


def _others_of(snapshot: Snapshot | None) -> dict[str, dict[str, int]]:
    others: dict[str, dict[str, int]] = {}
    for row in sorted(() if snapshot is None else snapshot.rows, key=lambda row: -row.count):
        if row.role == FOREIGN:
            others.setdefault(row.bus, {})[row.who] = row.count
    return others


def _others(bus: str, counts: dict[str, int]) -> str:
    named = [f"{who} {counted(count, 'frame')}" for who, count in counts.items()]
    more = f" and {len(named) - _OTHERS_NAMED} more" if len(named) > _OTHERS_NAMED else ""
    return f"{bus}: not of this dialect: {', '.join(named[:_OTHERS_NAMED])}{more}"


def _missing(port: PortStatus, ports: Sequence[PortStatus], buses: Mapping[str, Mapping[str, Any]]) -> int:
    """Return how much more decoding missed in the spools of a port's bus than its readers have told."""
    told = sum(each.dropped + each.kernel_dropped for each in ports if each.bus == port.bus)
    return max(0, int(buses.get(port.bus, {}).get("lost", 0)) - told)


def _lost(port: PortStatus, missing: int) -> str:
    parts = [f"{missing} {port.unit} missing in the spools"] if missing else []
    gaps = [gap for gap in port.gaps if not gap.kept]
    if gaps:
        parts.append(f"{counted(port.gap_count - len(port.gaps) + len(gaps), 'gap')}")
    parts += [f"{n} {name}" for name, n in port.counters.items() if name in LOSING]
    if port.dropped:
        parts.append(f"{port.dropped} {port.unit} dropped")
    if port.kernel_dropped:
        parts.append(f"{counted(port.kernel_dropped, 'frame')} in the kernel")
    return ", ".join(parts) or "nothing"


def _garbled(port: PortStatus) -> str:
    parts = [f"{n} {name}" for name, n in port.counters.items() if name not in LOSING]
    parts += [f"{reason} ({n})" for reason, n in port.bus_errors.items()]
    return ", ".join(parts)


def _gaps(port: PortStatus, utc_ns: int) -> list[str]:
    lines = []
    for gap in port.gaps[:_GAPS_NAMED]:
        start = clock_text(gap.from_ns + utc_ns)
        if gap.to_ns is None:
            span = f"from {start} to the end"
        else:
            span = f"{start}, for {(gap.to_ns - gap.from_ns) / 1e9:.3f} s"
        kept = " (the kernel buffered what came)" if gap.kept else ""
        lines.append(f"  {port.bus}: gap {span}: {gap.reason}{kept}")
    more = port.gap_count - min(len(port.gaps), _GAPS_NAMED)
    return lines + ([f"  {port.bus}: and {more} more gaps"] if more > 0 else [])


def clock_text(utc_ns: int) -> str:
    """Return a moment as UTC to the millisecond."""
    seconds, rest = divmod(utc_ns, 1_000_000_000)
    return time.strftime("%H:%M:%S", time.gmtime(seconds)) + f".{rest // 1_000_000:03d} UTC"
