"""Opens a line by the name of its endpoint. Each kind of line is imported only when it is opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from conformance.bus.line import Line


def open_line(endpoint: Endpoint) -> Line:
    """Open the host's end of a bus.

    Raises UsageError where it cannot be opened, with what to do about it.
    """
    if endpoint.auto:
        raise UsageError(f"{endpoint.text}: the speed is missing, expected baud=N (servotap scan finds it)")
    return _KINDS[endpoint.kind](endpoint)


def _serial(endpoint: Endpoint) -> Line:
    from conformance.bus.serial import SerialLine

    return SerialLine(endpoint)


def _tcp(endpoint: Endpoint) -> Line:
    from conformance.bus.tcp import TcpLine

    return TcpLine(endpoint)


def _can(endpoint: Endpoint) -> Line:
    from conformance.bus.can import CanLine

    return CanLine(endpoint)


_KINDS: Mapping[str, Callable[[Endpoint], Line]] = {"serial": _serial, "tcp": _tcp, "can": _can}
