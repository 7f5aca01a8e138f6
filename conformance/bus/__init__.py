"""Lines: the host's end of real and emulated buses. Only a gate writes to a line."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Any

from analyzer.catalogue import Dialect, Role
from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from conformance.bus.can_port import CanPort
from conformance.bus.line import Line

__all__ = ["at_default_rate", "open_can_port", "open_line"]

#: Kind of endpoint -> module and class of its line, imported only when one is opened.
_KINDS = {
    "serial": ("conformance.bus.serial", "SerialLine"),
    "tcp": ("conformance.bus.tcp", "TcpLine"),
    "can": ("conformance.bus.can", "CanLine"),
}
#: Likewise for the interfaces of CAN that are read without python-can, and for all others.
_INTERFACES = {
    "udp_multicast": ("conformance.bus.can_socket", "MulticastPort"),
    "socketcan": ("conformance.bus.python_can", "SocketCanPort"),
}
_LIBRARY = ("conformance.bus.python_can", "LibraryPort")


def open_line(endpoint: Endpoint) -> Line:
    """Open the host's end of a bus.

    Raises UsageError where it cannot be opened, with what to do about it.
    """
    if endpoint.auto:
        raise UsageError(f"{endpoint.text}: the speed is missing, expected baud=N (servotap scan finds it)")
    module, name = _KINDS[endpoint.kind]
    line: Line = getattr(import_module(module), name)(endpoint)
    return line


def open_can_port(interface: str, channel: str, *, heard_as: Role = Role.REQUEST, **options: Any) -> CanPort:
    """Open a port to a CAN bus. `options`: of the interface. Raises UsageError where it cannot be opened."""
    module, name = _INTERFACES.get(interface, _LIBRARY)
    place = (channel,) if interface in _INTERFACES else (interface, channel)
    port: CanPort = getattr(import_module(module), name)(*place, heard_as=heard_as, **options)
    return port


def at_default_rate(endpoint: Endpoint, dialect: Dialect) -> Endpoint:
    """Return a serial port without a rate at the dialect's default rate; its text then says so."""
    if endpoint.kind != "serial" or endpoint.speed is not None or endpoint.auto or not dialect.baud_rates:
        return endpoint
    return replace(endpoint, speed=dialect.baud_rates[0], text=f"{endpoint.text},baud={dialect.baud_rates[0]}")
