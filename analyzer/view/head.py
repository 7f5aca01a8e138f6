"""The head of the view: the file, its state, and a line for each bus with its load."""

from __future__ import annotations

from pathlib import PurePath

from rich.text import Text

from analyzer.cli.option_types import duration_text, size_text
from analyzer.live.snapshot import BusCounts
from analyzer.values import counted, printable
from analyzer.view.counts_panel import rate_text
from analyzer.view.source import ViewSource

#: Buses that have a line; the others are summed up.
BUS_LINES = 4
_BAR_WIDTH = 10


def head_text(source: ViewSource, width: int, *, paused: bool, waiting: int) -> Text:
    """Return the head as lines of at most `width`."""
    watch = source.watch
    errors, warnings, _ = watch.severities
    state = f"PAUSED, {waiting} wait" if paused else source.state
    words = [printable(PurePath(watch.log).name) or "servotap", state]
    if watch.log_bytes:
        words.append(size_text(watch.log_bytes))
    words += [duration_text(watch.span_ns), f"{counted(watch.frames, 'frame')}", f"{errors} E", f"{warnings} W"]
    if source.not_shown:
        words.append(f"{source.not_shown} not shown")
    line = "  ".join(words)
    if len(line) > width:
        # The file's name gives way: the numbers are what is watched.
        name = words[0]
        keep = max(8, len(name) - (len(line) - width) - 1)
        words[0] = "…" + name[-keep:] if keep < len(name) else name
        line = "  ".join(words)
    text = Text(no_wrap=True)
    text.append(line[:width].ljust(width), "bold reverse")
    buses = sorted(watch.buses.values(), key=lambda b: b.bus)
    for bus in buses[:BUS_LINES]:
        text.append("\n")
        text.append_text(_bus_line(bus, width, live=source.live))
    if len(buses) > BUS_LINES:
        rest = buses[BUS_LINES:]
        frames, failed = sum(b.frames for b in rest), sum(b.errors for b in rest)
        more = f"{len(rest)} more: {counted(frames, 'frame')}, {counted(failed, 'error')}"
        text.append("\n" + more[:width])
    return text


def _bus_line(bus: BusCounts, width: int, *, live: bool) -> Text:
    text = Text(no_wrap=True)
    text.append(f"{printable(bus.bus)[:10]:<10} ")
    if bus.load is not None:
        filled = min(_BAR_WIDTH, round(bus.load * _BAR_WIDTH))
        text.append("█" * filled + "░" * (_BAR_WIDTH - filled), "bold red" if bus.load > 0.9 else "green")
        text.append(f" {bus.load * 100:3.0f} % ")
    rate = "" if live else "average "
    text.append(f"{rate}{rate_text(bus.frame_rate)} frames/s {size_text(bus.byte_rate)}/s  {counted(bus.frames, 'frame')}")
    if bus.junk:
        text.append(f"  {bus.junk_bytes} B junk", "magenta")
    if bus.errors:
        text.append(f"  {bus.errors} E", "bold red")
    if bus.warnings:
        text.append(f"  {bus.warnings} W", "bold yellow")
    text.truncate(width)
    return text
