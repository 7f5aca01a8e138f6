"""A CAN bus as a line: a socket, or an interface of python-can. `can:INTERFACE:CHANNEL[,bitrate=N][,OPTION=VALUE...]`

An adapter is opened at the bit rate of the endpoint. A kernel interface (`socketcan`) keeps the rate set by `ip link`. Buses
without bits (`virtual`, `udp_multicast`) have no rate. The last two cannot change the rate later either.
"""

from __future__ import annotations

import time

from msgspec.structs import replace

from analyzer.catalogue import Role
from analyzer.errors import ServotapError, UsageError
from analyzer.live.endpoint import Endpoint
from analyzer.records import CanFrame
from conformance.bus import open_can_port
from conformance.bus.can_port import Acceptance, CanPort
from conformance.bus.line import Line, LineLost
from conformance.drives.can_bits import frame_bits

_SECOND_NS = 1_000_000_000
#: Interfaces whose bit rate is not theirs to set, and who sets it.
_FIXED = {"socketcan": "ip link set NAME type can bitrate N sets it", "virtual": "it has none", "udp_multicast": "it has none"}


class CanLine(Line):
    """A CAN bus. Raises UsageError where it cannot be opened, with what to do about it."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self.anchor_ns = time.time_ns() - time.monotonic_ns()
        self._free_ns = 0
        self._closed = False
        self._port = self._open(endpoint)
        self.acceptance: Acceptance = self._port.acceptance

    @staticmethod
    def _open(endpoint: Endpoint) -> CanPort:
        interface, channel = endpoint.interface
        options = dict(endpoint.options)
        if interface not in _FIXED or endpoint.speed is not None:
            options["bitrate"] = endpoint.bits_per_second
        try:
            return open_can_port(interface, channel, heard_as=Role.REPLY, **options)
        except UsageError as error:
            raise UsageError(f"{error}{_hint(interface, channel, str(error))}") from None

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def write(self, item: bytes | CanFrame) -> int:
        """Send a frame and return when the last of it is on the wire, should the bus be free. Only a gate calls this."""
        if not isinstance(item, CanFrame):
            raise TypeError("expected a CAN frame for a CAN bus, got bytes")
        self._check()
        bits = frame_bits(item.id, item.data, extended=item.extended)
        now_ns = self.now_ns()
        try:
            self._port.put(item)
        except ServotapError as error:
            raise LineLost(str(error)) from None
        speed = self.endpoint.speed
        self._free_ns = max(now_ns, self._free_ns) + (bits * _SECOND_NS // speed if speed else 0)
        return self._free_ns

    def receive(self, timeout_ns: int) -> CanFrame | None:
        """Return the next frame of others, None when the time is over."""
        self._check()
        deadline_ns = self.now_ns() + timeout_ns
        while True:
            left_ns = max(0, deadline_ns - self.now_ns())
            try:
                frame = self._port.receive(left_ns)
            except ServotapError as error:
                raise LineLost(str(error)) from None
            if frame is not None:
                return replace(frame, t_ns=self.now_ns(), port=self.endpoint.name)
            if not left_ns:
                return None

    def set_speed(self, bits_per_second: int) -> None:
        """Open the adapter anew at another bit rate. Raises UsageError where the rate is not its own."""
        interface, channel = self.endpoint.interface
        if interface in _FIXED:
            why = _FIXED[interface].replace("NAME", channel)
            raise UsageError(f"{interface}:{channel}: its bit rate cannot be set from here: {why}")
        self._port.close()
        changed = self.endpoint.at(bits_per_second)
        self._port = self._open(changed)
        self._port.acceptance = self.acceptance
        self.endpoint = changed

    def _check(self) -> None:
        if self._closed:
            raise LineLost(f"{self.endpoint.place} is gone: it was closed")

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._port.close()


def _hint(interface: str, channel: str, why: str) -> str:
    """Return what may help, where the cause is a common one."""
    if interface == "socketcan" and ("No such device" in why or "Errno 19" in why):
        return f"\n  is it there? ip link show {channel}; sudo ip link set {channel} up type can bitrate 500000"
    if interface == "socketcan" and "Network is down" in why:
        return f"\n  it is down: sudo ip link set {channel} up type can bitrate 500000"
    if "Permission denied" in why or "Errno 13" in why:
        from conformance.bus.serial import permission_hint

        return f"\n  {permission_hint(channel)}"
    return ""
