"""Listening to a CAN bus through any interface of python-can.

A frame is stamped when python-can hands it over, on the clock of the recording: the clocks of adapters differ from it and
from each other. An adapter that talks nonsense is told and listened to again; one that fails again and again is lost.
"""

from __future__ import annotations

import time
from typing import Any

from analyzer.errors import UsageError
from analyzer.live.can_listen_only import options_for
from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import BadCount, LibraryPort, Lost, Opened, Stop, Unopened, listen
from analyzer.live.reader_store import Store
from analyzer.live.spool import MOST_BYTES, CanFlag
from analyzer.plugins import close_bounded, is_failure, passed_over, reason
from analyzer.system.own_process import without

#: Failures to receive in a row after which the interface is taken to be gone.
FAILURES = 20
#: The longest wait for a frame: how late the wish to end is noticed.
_WAIT_S = 0.05
#: Frames taken in a row before they are stored, and for how long at most.
_AT_ONCE = 256
_BURST_NS = 10_000_000
#: The pause where an interface does not wait for a frame, but says at once that there is none.
_PAUSE_S = 0.001
#: Attributes of python-can's messages, and their flags in a spool.
_FLAGS = (
    ("is_extended_id", CanFlag.EXTENDED),
    ("is_remote_frame", CanFlag.REMOTE),
    ("is_error_frame", CanFlag.ERROR),
    ("is_fd", CanFlag.FD),
)


class CanLibraryPort(LibraryPort):
    """A python-can bus of which nothing is kept but the ways to receive and to close."""

    unit = "frames"
    library = "python-can"

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._receive: Any = None
        self._shut: Any = None
        #: Returns the descriptor behind the bus, where its interface has one.
        self._number: Any = None

    def open(self, stop: Stop) -> Opened:
        """Open the interface, listening only where it can."""
        with without("asammdf"):
            import can

        options, notes = options_for(self._endpoint)
        interface = options["interface"]
        if interface not in can.VALID_INTERFACES:
            raise UsageError(f"no CAN interface {interface!r} (python-can has {', '.join(sorted(can.VALID_INTERFACES))})")
        if options.get("state") == "passive":
            options["state"] = can.BusState.PASSIVE
        try:
            bus = can.Bus(**options)
        # Each interface raises what its library raises, and some leave the program.
        except BaseException as error:
            if not is_failure(error):
                raise
            raise Unopened(f"cannot open {self._endpoint.place}: {reason(error)}") from None
        self._receive, self._shut, self._number = bus.recv, bus.shutdown, bus.fileno
        return Opened("stamped as python-can hands a frame over; plus the delays of adapter and driver", tuple(notes))

    def listen(self, store: Store, stop: Stop) -> None:
        """Store what comes. Raises Lost when receiving fails again and again."""
        bad = BadCount("")
        failures = 0

        def take(ready: bool) -> int:
            nonlocal failures
            try:
                from_ns = time.monotonic_ns()
                last_ns = self._take(store, _WAIT_S)
                if not last_ns and time.monotonic_ns() - from_ns < _PAUSE_S * 1e9:
                    stop.wait(_PAUSE_S)
            # Garbage on an adapter's port raises from deep inside its driver.
            except BaseException as error:
                if not is_failure(error):
                    raise
                failures += 1
                bad.count += 1
                bad.reason = reason(error)
                if failures >= FAILURES:
                    raise Lost(bad.reason) from None
                stop.wait(0.01)
                return 0
            failures = 0
            return last_ns

        try:
            listen(store, stop, take, tick=lambda now_ns: bad.tell(store, now_ns))
            # What had come before the end; a bus that fails now has no more.
            with passed_over():
                self._take(store, 0.0)
        finally:
            store.flush()

    def _take(self, store: Store, wait_s: float) -> int:
        """Store what is there, or comes within `wait_s`; return the time of the last frame, 0 if there was none."""
        first_ns = last_ns = 0
        for _ in range(_AT_ONCE):
            message = self._receive(wait_s)
            if message is None:
                break
            wait_s = 0.0
            last_ns = time.monotonic_ns()
            keep(store, last_ns, message)
            first_ns = first_ns or last_ns
            if last_ns - first_ns > _BURST_NS:
                break
        return last_ns

    def close(self) -> None:
        shut, self._shut, self._receive, self._number = self._shut, None, None, None
        if shut is not None:
            close_bounded(self._endpoint.place, shut)


def keep(store: Store, t_ns: int, message: Any) -> None:
    """Store a message of python-can. Raises ValueError for one that is no frame."""
    data = message.data or b""
    if not isinstance(data, (bytes, bytearray)) or len(data) > MOST_BYTES:
        raise ValueError(f"expected at most {MOST_BYTES} data bytes, got {len(data) if hasattr(data, '__len__') else data!r}")
    flags = flags_of(message)
    if not message.is_rx:
        flags |= CanFlag.TX
    store.can(t_ns, message.arbitration_id, flags, bytes(data))


def flags_of(message: Any) -> int:
    """Return what a message of python-can, or one that has its attributes, says of its frame."""
    return sum(flag for name, flag in _FLAGS if getattr(message, name))
