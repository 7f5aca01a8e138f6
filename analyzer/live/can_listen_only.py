"""CAN buses: which interface can listen without taking part, and what the user must know of one that cannot.

A CAN controller that only listens sends no acknowledgement, no error frame, nothing. Whether it can be told so is a matter
of the interface, in this table (python-can's interfaces, by their names there):

    LISTEN_ONLY   options for python-can, which override the user's
    HARMLESS      there is no bus that could be disturbed
    all others    python-can cannot tell them; they are opened as they are, and it is told that they take part

SocketCAN is a setting of the kernel (`ip link set can0 type can ... listen-only on`) and is looked up, not set.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from analyzer.errors import UsageError
from analyzer.live.adapters import ask_ip, links_of
from analyzer.live.endpoint import DEFAULT_BITRATE, Endpoint


class Listening(NamedTuple):
    """How an interface is kept silent. `options`: for python-can; `doubt`: what is not certain even so."""

    options: Mapping[str, Any] = {}
    doubt: str = ""


#: Interfaces that can be told to listen only. `passive` stands for python-can's `BusState.PASSIVE`.
LISTEN_ONLY: Mapping[str, Listening] = {
    "slcan": Listening({"listen_only": True}, "it was told to listen only (L); an adapter without that mode refuses"),
    "vector": Listening({"listen_only": True}, "it only listens if no other program holds the channel's init access"),
    "nixnet": Listening({"listen_only": True}),
    "cantact": Listening({"monitor": True}),
    # `False` is python-can's DRIVER_MODE_SILENT; not every Kvaser device knows it.
    "kvaser": Listening({"driver_mode": False}, "a Kvaser device without silent mode takes part anyway"),
    "pcan": Listening({"state": "passive"}),
    "systec": Listening({"state": "passive"}),
    "seeedstudio": Listening({"operation_mode": "silent"}),
}
#: Interfaces without a bus that a listener could disturb.
HARMLESS = frozenset({"virtual", "udp_multicast"})
#: Interfaces whose bit rate is not this end's to set.
NO_BITRATE = frozenset({"virtual", "udp_multicast", "socketcan", "socketcand"})
_TAKES_PART = (
    "python-can cannot tell {} to listen only: it acknowledges frames, and disturbs a bus that runs at another bit rate"
)


def options_for(endpoint: Endpoint) -> tuple[dict[str, Any], list[str]]:
    """Return python-can's options for an endpoint, and notes for the user.

    Raises UsageError where a wrong bit rate would disturb the bus and none is given.
    """
    interface, channel = endpoint.interface
    listening = LISTEN_ONLY.get(interface)
    notes = []
    options: dict[str, Any] = {**endpoint.options}
    if listening is not None:
        overruled = [f"{k}={options[k]}" for k, v in listening.options.items() if k in options and options[k] != v]
        if overruled:
            notes.append(f"{', '.join(overruled)} is ignored: a recording only listens")
        options |= listening.options
        if listening.doubt:
            notes.append(listening.doubt)
    elif interface not in HARMLESS:
        notes.append(_TAKES_PART.format(interface))
    if interface not in NO_BITRATE:
        if endpoint.speed is None and listening is None:
            raise UsageError(f"{endpoint}: {interface} takes part in the bus, so it needs the rate: bitrate=N")
        if endpoint.speed is None:
            notes.append(f"no bitrate given: {DEFAULT_BITRATE}")
        options["bitrate"] = endpoint.bits_per_second
    options |= {"interface": interface, "channel": int(channel) if channel.isdigit() else channel}
    return options, notes


def kernel_notes(channel: str, speed: int | None) -> list[str]:
    """Return what the kernel's settings of a SocketCAN interface are worth telling. `speed`: what the user said it runs at."""
    return notes_of_link(links_of(ask_ip()).get(channel), channel, speed)


def notes_of_link(link: Mapping[str, Any] | None, channel: str, speed: int | None) -> list[str]:
    """Return what is worth telling of an interface as `ip -details -json link` shows it; None where it could not be asked."""
    if link is None:
        return [f"whether {channel} only listens is unknown (check with ip -details link show {channel})"]
    info = link.get("linkinfo", {})
    if info.get("info_kind") != "can":
        # A virtual interface (vcan, vxcan): no wire.
        return []
    data = info.get("info_data", {})
    notes = []
    if "LISTEN-ONLY" not in data.get("ctrlmode", ()):
        notes.append(
            f"{channel} is not in listen-only mode and acknowledges frames; to change that: ip link set {channel} down; "
            f"ip link set {channel} type can listen-only on; ip link set {channel} up"
        )
    actual = data.get("bittiming", {}).get("bitrate")
    if speed is not None and actual and actual != speed:
        notes.append(f"{channel} runs at {actual} bit/s instead of {speed}")
    return notes
