"""A reader process: it waits for one port, reads, stamps and stores.

    python -m analyzer.live.reader FOLDER STEM [--adopt FD] [--hand FD] [--first-segment N] [--plain]

FOLDER holds the recording's configuration, STEM names the spool there. Events go to the spool and, one line of JSON each,
to standard output. Standard input ends when the supervisor does: then, or at SIGTERM, the reader takes what has come, notes
the end and leaves. A port that is lost is opened again, after 0.1 s at first and 2 s in the end.

Exit status: 0 ended as asked; 2 the port could not be opened at the start (the reason is told as the event `failed`).
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import socket
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from analyzer.errors import ServotapError
from analyzer.live import config
from analyzer.live.config import PortConfig
from analyzer.live.endpoint import Endpoint, parse
from analyzer.live.lock import RUNNING, Lock
from analyzer.live.reader_hand import Hand
from analyzer.live.reader_port import LEASH, Lost, Opened, Port, Stop, Unopened
from analyzer.live.reader_store import StatusLine, Store
from analyzer.live.reader_stream import take_over
from analyzer.live.spool import RecordKind, SpoolWriter, last_record
from analyzer.system import own_process

FIRST_RETRY_S = 0.1
LAST_RETRY_S = 2.0
#: Kind of endpoint -> module and class of its port. CAN: through a socket where there is one, else through python-can.
_KINDS = {
    "serial": ("analyzer.live.reader_serial", "SerialPort"),
    "plain": ("analyzer.live.reader_pyserial", "PlainPort"),
    "tcp": ("analyzer.live.reader_tcp", "TcpPort"),
    "socket": ("analyzer.live.reader_can_socket", "CanSocketPort"),
    "slcan": ("analyzer.live.reader_can_slcan", "SlcanPort"),
    "can": ("analyzer.live.reader_can_library", "CanLibraryPort"),
}
#: CAN interfaces that are sockets -> the options of an endpoint that their reader understands.
_SOCKETS = {"socketcan": frozenset[str](), "udp_multicast": frozenset({"port", "hop_limit"})}


def make_port(endpoint: Endpoint, plain: bool = False) -> Port:
    """Return the port of an endpoint. `plain`: as where there is no Linux, by pyserial's and python-can's own reads."""
    kind = endpoint.kind
    plain = plain or sys.platform != "linux"
    if kind == "serial" and plain:
        kind = "plain"
    elif kind == "can" and not plain:
        known = _SOCKETS.get(endpoint.interface[0])
        if known is not None and not endpoint.options.keys() - known:
            kind = "socket"
        elif endpoint.interface[0] == "slcan":
            kind = "slcan"
    module, name = _KINDS[kind]
    make: Callable[[Endpoint], Port] = getattr(import_module(module), name)
    return make(endpoint)


def endpoint_of(port: PortConfig) -> Endpoint:
    """Return the endpoint of a configured port, at the speed that was found out for it."""
    endpoint = parse(port.endpoint)
    return replace(endpoint, speed=port.speed, auto=False)


class Reader:
    """Keeps one port open and stores what it brings, until the end is requested.

    `hand_over` is given the descriptor of each port that was opened: who keeps it can give it to a successor.
    """

    def __init__(self, port: Port, store: Store, stop: Stop, hand_over: Callable[[int], None]) -> None:
        self._port = port
        self._store = store
        self._stop = stop
        self._hand_over = hand_over
        self._reason = ""

    def run(self, adopted: int | None = None, forerunner_ns: int | None = None) -> str:
        """Read until the end is requested; return why. `forerunner_ns`: time of the last record of a reader that died.

        Raises Unopened when the port cannot be opened at the start; a successor of another reader goes on trying.
        """
        store, stop = self._store, self._stop
        lost_ns = forerunner_ns
        kept = False
        if adopted is not None:
            try:
                opened = self._port.adopt(adopted)
                kept = True
            except Unopened:
                # It has gone meanwhile; it is opened like any other.
                os.close(adopted)
        while not stop.asked:
            if not kept:
                found = self._open(first=lost_ns is None)
                if found is None:
                    break
                opened = found
                descriptor = self._port.descriptor()
                if descriptor is not None:
                    self._hand_over(descriptor)
            self._tell(opened, lost_ns, kept)
            kept = False
            try:
                self._port.listen(store, stop)
            except Lost as lost:
                self._port.close()
                lost_ns = time.monotonic_ns()
                store.event("lost", lost_ns, reason=str(lost))
        self._port.close()
        store.close(stop.asked)
        return stop.asked

    def _open(self, first: bool) -> Opened | None:
        """Open the port, in as many attempts as it takes; None when the end is requested meanwhile."""
        wait_s = 0.0 if first else FIRST_RETRY_S
        while not self._stop.wait(wait_s):
            try:
                return self._port.open(self._stop)
            except Unopened as reason:
                if first:
                    raise
                if str(reason) != self._reason:
                    self._store.event("note", text=str(reason))
                self._reason = str(reason)
                self._store.flush()
            except Lost:
                # The end was requested while it waited for an answer.
                return None
            wait_s = min(wait_s * 2, LAST_RETRY_S)
        return None

    def _tell(self, opened: Opened, lost_ns: int | None, kept: bool) -> None:
        store = self._store
        self._reason = ""
        about = {"notes": list(opened.notes), "precision": opened.precision}
        if kept:
            # At the time of what the other one stored last: what has waited since then comes after it.
            assert lost_ns is not None  # what is adopted was another's
            gap_ns = time.monotonic_ns() - lost_ns
            store.event("note", store.last_ns, text=_TAKEN_OVER, from_ns=lost_ns, gap_ns=gap_ns, kept=True)
            return
        now_ns = time.monotonic_ns()
        if lost_ns is None:
            store.event("open", now_ns, **about)
        else:
            store.event("back", now_ns, gap_ns=now_ns - lost_ns, from_ns=lost_ns, reason="", **about)


_TAKEN_OVER = (
    "the reader process died and another one took over the port; the kernel buffered the traffic in between, whose times are "
    "those of the end of that wait"
)


def hand_over(descriptor: int) -> None:
    """Give the supervisor a second hold on a port, so that what arrives waits in the kernel should this process die."""
    if not hasattr(socket, "send_fds"):
        return
    # Standard input is not a socket if the reader was started by hand; then no supervisor wants the port.
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(LEASH)) as leash:
        socket.send_fds(leash, [b"p"], [descriptor])


def main(words: Sequence[str] | None = None) -> int:
    """Run one reader; see the module."""
    parser = argparse.ArgumentParser(prog="reader")
    parser.add_argument("folder", type=Path)
    parser.add_argument("stem")
    parser.add_argument("--adopt", type=int)
    parser.add_argument("--hand", type=int)
    parser.add_argument("--first-segment", type=int, default=0)
    parser.add_argument("--plain", action="store_true")
    arguments = parser.parse_args(words)
    stop = Stop()
    stop.on_signals()
    stop.on_leash()
    if hasattr(os, "set_blocking"):
        os.set_blocking(sys.stdout.fileno(), False)
    tell = StatusLine(sys.stdout.fileno())
    try:
        recording = config.load(arguments.folder)
        lock = Lock(arguments.folder, RUNNING, shared=True)
        endpoint = endpoint_of(next(p for p in recording.ports if p.stem == arguments.stem))
        port = make_port(endpoint, arguments.plain)
        before = last_record(arguments.folder, arguments.stem)
        stored = 0 if before is None else before.before + before.units
        hand = None if arguments.hand is None else Hand(arguments.hand)
        left = None if hand is None else hand.left(stored)
        last_ns = max(0 if before is None else before.t_ns, 0 if left is None else left.last_ns)
        store = Store(
            SpoolWriter(arguments.folder, arguments.stem, limit=recording.max_spool, first=arguments.first_segment),
            tell,
            unit=port.unit,
            count=stored if left is None else left.stored,
            last_ns=last_ns,
            idle=before is not None and before.kind != RecordKind.DATA,
            hand=hand,
        )
        # Its spool may have been deleted, and it may have left nothing else.
        forerunner_ns = (
            (last_ns or time.monotonic_ns()) if arguments.first_segment or arguments.adopt is not None or last_ns else None
        )
        if left is not None:
            take_over(store, left, endpoint.byte_ns)
        # What is loaded stays, and need not be looked at again and again.
        gc.collect()
        gc.freeze()
        Reader(port, store, stop, hand_over).run(arguments.adopt, forerunner_ns)
        lock.close()
    except (Unopened, ServotapError) as error:
        tell(time.monotonic_ns(), "failed", {"reason": str(error)})
        return 2
    return 0


if __name__ == "__main__":
    own_process.take()
    with contextlib.suppress(BrokenPipeError):
        sys.exit(main())
