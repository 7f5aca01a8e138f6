"""What a recording shows while it runs: a live table, a line a second, JSON lines, or the terminal view."""

from __future__ import annotations

import queue
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

import msgspec

from analyzer.cli.boundary import report
from analyzer.cli.option_types import duration_text, size_text
from analyzer.cli.record_report import Summary, as_text
from analyzer.live.snapshot import BusCounts, Snapshot
from analyzer.live.supervisor import Supervisor
from analyzer.values import counted, printable

if TYPE_CHECKING:
    from rich.table import Table

_SECOND_S = 1.0
#: Decoding that lags less keeps up: it works in portions.
_BEHIND_NS = 1_000_000_000
#: How often the live table is drawn, and notes are looked for.
_LOOK_S = 0.25


def counts(supervisor: Supervisor) -> list[tuple[str, str, BusCounts]]:
    """Return the buses with the state of their ports and their counts."""
    snapshot = supervisor.snapshot
    known = {} if snapshot is None else {bus.bus: bus for bus in snapshot.buses}
    states: dict[str, str] = {}
    for port in supervisor.tallies.values():
        # If one direction of a bus is lost, the bus is.
        if states.get(port.bus) != "lost":
            states[port.bus] = port.state
    return [(bus, state, known.get(bus, BusCounts(bus))) for bus, state in states.items()]


def behind(supervisor: Supervisor) -> tuple[float, int]:
    """Return by how many seconds and about how many frames decoding lags behind what is stored; 0 where it keeps up."""
    snapshot = supervisor.snapshot
    if snapshot is None or snapshot.behind_ns <= _BEHIND_NS:
        return 0.0, 0
    frames = 0
    for bus, _, count in counts(supervisor):
        ports = [port for port in supervisor.tallies.values() if port.bus == bus]
        stored = sum((port.count or 0) - port.dropped for port in ports)
        if ports[0].unit == "frames":
            frames += max(0, stored - count.frames)
        else:
            waiting = max(0, stored - count.bytes - count.junk_bytes)
            frames += round(waiting * count.frames / count.bytes) if count.bytes else 0
    return snapshot.behind_ns / 1e9, frames


def _behind_text(supervisor: Supervisor) -> str:
    """Return that in words, empty where it keeps up."""
    seconds, frames = behind(supervisor)
    return f"decoding is {duration_text(int(seconds * 1e9))} behind, about {counted(frames, 'frame')}" if seconds else ""


def _stored(supervisor: Supervisor, bus: str) -> str:
    """Return what the readers of a bus have stored, about a second ago."""
    ports = [port for port in supervisor.tallies.values() if port.bus == bus]
    return f"{sum(port.count or 0 for port in ports)} {ports[0].unit}"


def seconds_of(supervisor: Supervisor) -> float:
    """Return how long it has been recording."""
    until_ns = supervisor.ended_ns or time.monotonic_ns()
    return (until_ns - supervisor.began_ns) / 1e9 if supervisor.began_ns else 0.0


class Display:
    """Shows a recording: a line a second on standard output, notes on standard error. Subclasses show it in other ways.

    `unprinted`: why a line could not be printed, of several the first; None where all were.
    `note` and `snapshot` are called from the supervisor's thread, the others from the main one. That alone prints: a reader
    of our output that stalls holds up no recording.
    """

    #: Causes that were told.
    _told: frozenset[str] = frozenset()
    #: The line that was shown last.
    _shown = ""
    unprinted: OSError | None = None

    def __init__(self) -> None:
        #: Bus and text of each note that was not told yet.
        self._notes: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()

    def _out(self, text: str) -> None:
        """Print a line in one write. A recording goes on though the reader of its output has gone, or its disk is full."""
        try:
            print(text + "\n", end="", flush=True)
        except OSError as error:
            self.unprinted = self.unprinted or error

    def note(self, bus: str, text: str) -> None:
        """Take what happened, on one bus or on all; `tell_notes` tells it."""
        self._notes.put((bus, text))

    def tell_notes(self) -> None:
        while not self._notes.empty():
            self._tell(*self._notes.get())

    def _tell(self, bus: str, text: str) -> None:
        print(printable(f"{bus}: {text}" if bus else text) + "\n", end="", file=sys.stderr, flush=True)

    def snapshot(self, snapshot: Snapshot) -> None:
        """Tell causes of trouble that are new; the supervisor keeps the newest."""
        for cause, lines in snapshot.causes.items() if snapshot.causes.keys() - self._told else ():
            if cause not in self._told and not snapshot.ended:
                self._told |= {cause}
                for line in lines:
                    self.note("", line)

    def say(self, text: str) -> None:
        """Tell something about the program itself; called from a signal handler, too."""
        # Not `print`: the signal may have come in the middle of one.
        sys.stderr.flush()
        with open(2, "wb", buffering=0, closefd=False) as stderr:
            stderr.write(f"servotap record: {text}\n".encode())

    def begin(self, supervisor: Supervisor) -> None:
        buses = ", ".join(dict.fromkeys(p.bus for p in supervisor.tallies.values()))
        self._out(f"recording {printable(buses)} to {printable(supervisor.config.log)}; Ctrl-C ends it")

    def watch(self, supervisor: Supervisor, thread: threading.Thread) -> None:
        due = time.monotonic() + _SECOND_S
        while thread.is_alive():
            thread.join(min(_LOOK_S, max(0.0, due - time.monotonic())))
            self.tell_notes()
            if time.monotonic() >= due and thread.is_alive():
                due = max(due + _SECOND_S, time.monotonic())
                self.line(supervisor)

    def line(self, supervisor: Supervisor) -> None:
        parts = [f"{seconds_of(supervisor):.0f} s"]
        for bus, state, count in counts(supervisor):
            trouble = f", {state}" if state != "listening" else ""
            junk = f", {count.junk_bytes} junk" if count.junk_bytes else ""
            found = count.errors + count.warnings
            findings = f", {found} finding{'s' * (found > 1)}" if found else ""
            if supervisor.config.raw_only:
                parts.append(f"{bus} {_stored(supervisor, bus)}{trouble}")
            else:
                parts.append(f"{bus} {counted(count.frames, 'frame')}, {count.frame_rate:.0f}/s{junk}{findings}{trouble}")
        snapshot = supervisor.snapshot
        if snapshot is not None:
            parts.append(size_text(snapshot.log_bytes))
        if late := _behind_text(supervisor):
            parts.append(late)
        if supervisor.phase in ("ending", "finishing"):
            parts.append("finishing the log")
        shown = printable("  ".join(parts))
        # While the log is finished nothing may change for long.
        if shown != self._shown:
            self._shown = shown
            self._out(shown)

    def end(self, summary: Summary) -> None:
        self._out("\n".join(as_text(summary)))


class JsonDisplay(Display):
    """The same as lines of JSON, each with an "event": begin, counts, note, end."""

    def _print(self, event: str, **about: Any) -> None:
        self._out(msgspec.json.encode({"event": event, **about}).decode())

    def _tell(self, bus: str, text: str) -> None:
        self._print("note", bus=bus, text=text)

    def begin(self, supervisor: Supervisor) -> None:
        ports = [
            {"bus": p.bus, "endpoint": p.endpoint, "precision": p.precision, "notes": p.notes}
            for p in supervisor.tallies.values()
        ]
        self._print("begin", log=supervisor.config.log, ports=ports)

    def line(self, supervisor: Supervisor) -> None:
        snapshot = supervisor.snapshot
        seconds, frames = behind(supervisor)
        buses = [{"state": state, **msgspec.structs.asdict(count)} for _, state, count in counts(supervisor)]
        ports = [{"bus": p.bus, "endpoint": p.endpoint, p.unit: p.count or 0} for p in supervisor.tallies.values()]
        self._print(
            "counts",
            seconds=round(seconds_of(supervisor), 1),
            phase=supervisor.phase,
            buses=buses,
            ports=ports,
            log=supervisor.config.log if snapshot is None else snapshot.log,
            log_bytes=0 if snapshot is None else snapshot.log_bytes,
            behind=seconds,
            behind_frames=frames,
            rules={} if snapshot is None else snapshot.rules,
        )

    def end(self, summary: Summary) -> None:
        self._print("end", **msgspec.to_builtins(summary))


class TableDisplay(Display):
    """A table that is drawn again and again, with the notes above it."""

    def __init__(self) -> None:
        from analyzer.cli.console import Console

        super().__init__()
        self._console = Console(highlight=False)

    def _tell(self, bus: str, text: str) -> None:
        from rich.text import Text

        self._console.print(Text(printable(f"{bus}: {text}" if bus else text), style="yellow"))

    def watch(self, supervisor: Supervisor, thread: threading.Thread) -> None:
        from rich.live import Live

        with Live(console=self._console, auto_refresh=False, transient=True) as live:
            while thread.is_alive():
                self.tell_notes()
                live.update(self._table(supervisor), refresh=True)
                thread.join(_LOOK_S)

    def _table(self, supervisor: Supervisor) -> Table:
        from rich.text import Text

        from analyzer.cli.console import table

        snapshot = supervisor.snapshot
        numbers = ("stored", "frames", "/s", "bytes/s", "load", "junk", "findings")
        shown = table("bus", "", *numbers, numbers=numbers, caption_justify="left")
        for bus, state, count in counts(supervisor):
            shown.add_row(
                Text(printable(bus)),
                Text(state, style="" if state == "listening" else "red"),
                _stored(supervisor, bus),
                str(count.frames),
                f"{count.frame_rate:.0f}",
                f"{count.byte_rate:.0f}",
                "" if count.load is None else f"{100 * count.load:.0f} %",
                str(count.junk_bytes or ""),
                Text(str((count.errors + count.warnings) or ""), style="red" if count.errors else "yellow"),
            )
        size = size_text(snapshot.log_bytes) if snapshot is not None else "0 B"
        late = _behind_text(supervisor)
        doing = "finishing the log" if supervisor.phase in ("ending", "finishing") else "Ctrl-C ends it"
        shown.caption = Text(f"{duration_text(int(seconds_of(supervisor) * 1e9))}, {size}{late and ', '}{late}; {doing}")
        return shown


class ViewDisplay(Display):
    """The terminal view, which shows events by itself; notes wait until it is closed."""

    def __init__(self) -> None:
        from analyzer.view.live import SnapshotQueue

        super().__init__()
        self._snapshots = SnapshotQueue()
        self._open = True

    def snapshot(self, snapshot: Snapshot) -> None:
        self._snapshots.offer(snapshot)

    def say(self, text: str) -> None:
        if not self._open:
            super().say(text)

    def watch(self, supervisor: Supervisor, thread: threading.Thread) -> None:
        from analyzer.view import run_live

        threading.Thread(target=self._end_with, args=(thread,), daemon=True).start()

        def mark(text: str) -> str:
            supervisor.mark(text)
            return ""

        config = supervisor.config
        try:
            why = run_live(self._snapshots, mark=mark, log=config.log, model=config.model)
        except Exception as error:
            report(error)
            why = "see above"
        self._open = False
        self.tell_notes()
        if why not in ("quit", "ended"):
            self.note("", f"the view failed ({why}); the recording continues, Ctrl-C ends it")
        elif thread.is_alive():
            supervisor.stop("the view was closed")
        super().watch(supervisor, thread)

    def _end_with(self, thread: threading.Thread) -> None:
        """End the view when the recording is over."""
        thread.join()
        self._snapshots.close()
