"""The process of a tap: `python -m conformance.tap.process FOLDER REQUEST-STEM REPLY-STEM --terminal MASTER SLAVE ...`

FOLDER holds the recording's configuration; the stems name the spools of the two directions. MASTER and SLAVE are descriptors of
the pseudo-terminal. The supervisor holds them too, so the program's port outlives this process. Events go to standard output,
one line of JSON each, with the stem. SIGTERM ends the process. If the supervisor dies, the process continues until the program
closes its port.

Exit status: 0 ended by SIGTERM; 2 the adapter could not be opened at the start (the event `failed` has the reason).
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from analyzer.errors import ServotapError
from analyzer.live import config
from analyzer.live.lock import RUNNING, Lock
from analyzer.live.reader import endpoint_of, hand_over
from analyzer.live.reader_port import Stop, Unopened
from analyzer.live.reader_serial import holders
from analyzer.live.reader_store import StatusLine, Store
from analyzer.live.spool import Record, RecordKind, SpoolWriter, last_record
from conformance.tap.adapter import Adapter, Wiring, adapter_of
from conformance.tap.passing import Passing
from conformance.tap.settings import of_endpoint
from conformance.tap.storing import REPLY, REQUEST, Storing, Taken
from conformance.tap.terminal import Terminal

#: A thread of ours that computes gives way after this many seconds when bytes come.
_SWITCH_S = 0.0005
_TAKEN_OVER = "the tap's process died and another one has taken over; the program's port and the adapter stayed open"
_DIED = "the tap's process died before it had stored them; they were passed on"
_REQUEST_PRECISION = "reckoned: the end of sending, from when the program wrote and the speed of the line"
_SIDES = {"on": True, "off": False, "leave": None}


class TapStop(Stop):
    """The wish to end, told apart by where it comes from. `terminated`: asked by a signal, not by a supervisor's death."""

    terminated = False

    def _signalled(self, number: int, frame: FrameType | None) -> None:
        self.terminated = True
        super()._signalled(number, frame)


def main(words: Sequence[str] | None = None) -> int:
    """Run the process; see the module."""
    arguments = _parser().parse_args(words)
    stop = TapStop()
    stop.on_signals()
    stop.on_leash()
    os.set_blocking(sys.stdout.fileno(), False)
    status = StatusLine(sys.stdout.fileno())
    _go_first()

    def tell(stem: str, t_ns: int, event: str, about: dict[str, Any]) -> None:
        status(t_ns, event, {"stem": stem, **about})

    try:
        with Lock(arguments.folder, RUNNING, shared=True):
            _run(arguments, stop, tell)
    except (Unopened, ServotapError) as error:
        tell(arguments.reply, time.monotonic_ns(), "failed", {"reason": str(error)})
        return 2
    finally:
        _remove_link(arguments.link, arguments.terminal[1])
    return 0


def _go_first() -> None:
    """Run before all usual processes, where that is allowed: the bytes of a machine wait for this one, and it needs little."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tap")
    parser.add_argument("folder", type=Path)
    parser.add_argument("request")
    parser.add_argument("reply")
    parser.add_argument("--terminal", type=int, nargs=2, required=True)
    parser.add_argument("--link", default="")
    parser.add_argument("--rts", choices=tuple(_SIDES), default="leave")
    parser.add_argument("--dtr", choices=tuple(_SIDES), default="leave")
    parser.add_argument("--rs485", action="store_true")
    parser.add_argument("--adopt", type=int)
    parser.add_argument("--first-segment", type=int, default=0)
    return parser


def _run(arguments: argparse.Namespace, stop: TapStop, tell: Any) -> None:
    recording = config.load(arguments.folder)
    endpoint = endpoint_of(next(p for p in recording.ports if p.stem == arguments.reply))
    adapter = adapter_of(endpoint, Wiring(_SIDES[arguments.rts], _SIDES[arguments.dtr], arguments.rs485))
    stems = {REQUEST: arguments.request, REPLY: arguments.reply}
    before = {direction: last_record(arguments.folder, stem) for direction, stem in stems.items()}
    limit = recording.max_spool
    first = arguments.first_segment
    writers = {d: SpoolWriter(arguments.folder, s, limit=limit, first=first) for d, s in stems.items()}
    storing = Storing({d: _store(writers[d], s, before[d], tell) for d, s in stems.items()})
    stored = {d: 0 if record is None else record.before + record.units for d, record in before.items()}
    taken = Taken.at(arguments.folder / f"{arguments.reply}.taken", stored)
    terminal = Terminal(*arguments.terminal, others=lambda: _others(arguments.terminal[1]))
    named = of_endpoint(endpoint)
    _open(adapter, arguments.adopt, stop, storing, before[REPLY], named)
    hand_over(adapter.fd)
    passing = Passing(terminal, adapter, storing, stop, named, keep_on=lambda: not stop.terminated)
    passing.on_open = hand_over
    if taken is not None:
        passing.on_taken = taken.add
        for direction, count in (taken.before or {}).items():
            record = before[direction]
            if count > stored[direction]:
                from_ns = record.t_ns if record is not None else time.monotonic_ns()
                storing.dropped(direction, count - stored[direction], from_ns, _DIED)
    sys.setswitchinterval(_SWITCH_S)
    # What is loaded stays, and need not be looked at again and again.
    gc.collect()
    gc.freeze()
    try:
        passing.run()
    finally:
        adapter.close()
        terminal.close()
        storing.close(stop.asked or "the tap broke off")


def _store(writer: SpoolWriter, stem: str, before: Record | None, tell: Any) -> Store:
    return Store(
        writer,
        lambda t_ns, event, about: tell(stem, t_ns, event, about),
        count=0 if before is None else before.before + before.units,
        last_ns=0 if before is None else before.t_ns,
        idle=before is not None and before.kind != RecordKind.DATA,
    )


def _open(adapter: Adapter, adopted: int | None, stop: Stop, storing: Storing, before: Record | None, named: Any) -> None:
    """Open the adapter, or take it over from a process that died, and tell which."""
    if adopted is not None:
        adapter.adopt(adopted)
        from_ns = before.t_ns if before is not None else time.monotonic_ns()
        gap_ns = time.monotonic_ns() - from_ns
        storing.event(REPLY, "note", text=_TAKEN_OVER, from_ns=from_ns, gap_ns=gap_ns, kept=True)
        return
    opened = adapter.open(stop, named)
    now_ns = time.monotonic_ns()
    about: dict[str, Any] = {"notes": list(opened.notes), "precision": opened.precision}
    if before is None:
        storing.event(REQUEST, "open", now_ns, precision=_REQUEST_PRECISION)
        storing.event(REPLY, "open", now_ns, **about)
        return
    storing.event(REPLY, "back", now_ns, gap_ns=now_ns - before.t_ns, from_ns=before.t_ns, reason="", **about)


def _others(terminal: int) -> bool:
    """Say whether a process besides this one and its supervisor has the program's end open."""
    return any(f"process {os.getppid()})" not in holder for holder in holders(terminal))


def _remove_link(link: str, terminal: int) -> None:
    """Remove the link where the supervisor can do so no more."""
    if link and os.getppid() == 1:
        with contextlib.suppress(OSError):
            os.unlink(link)


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        sys.exit(main())
