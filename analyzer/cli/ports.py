"""List serial ports and CAN interfaces, each with the endpoint to give to `servotap record`.

Nothing is opened. For a serial port it shows the adapter, and its latency timer with the way to lower it. It also shows which
program has the port open, and whether you may open it. For a CAN interface it shows state, bit rate and error counters.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.live.adapters import LOW_LATENCY_MS, CanInterface, SerialAdapter, can_interfaces, detected, serial_adapters
from analyzer.values import printable

EXAMPLES = """\
examples:
  servotap ports
  servotap ports --json | jq -r '.serial[].endpoint'
  servotap record left=$(servotap ports --json | jq -r '.serial[0].endpoint')
"""

_RULES = "/etc/udev/rules.d/99-latency-timer.rules"
_UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'

_NO_SERIAL = """\
  none. Check:
    - the cable carries data, not only power; `lsusb` should list the adapter, `sudo dmesg | tail` its port
    - brltty, on some systems, takes CH340 adapters away: sudo systemctl mask --now brltty-udev
    - in a container or virtual machine the port has to be passed through (docker: --device /dev/ttyUSB0; WSL: usbipd)
"""
_NO_CAN = """\
  none. Check:
    - the adapter's module is there: sudo modprobe can_raw gs_usb (candleLight, CANable), or that of its maker
    - adapters of the slcan kind are serial ports (above): can:slcan:/dev/ttyACM0,bitrate=500000
    - an interface that exists but is down is listed; one that is not has no driver
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--json", action="store_true", help="print everything as one JSON object")
    parser.add_argument(
        "--no-detect", action="store_true", help="skip adapters of python-can's interfaces (asking takes a second)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print what there is; return 0."""
    serial, can = serial_adapters(), can_interfaces()
    why = ""
    if not arguments.no_detect:
        from analyzer.live.can_adapters import detect

        configs, why = detect()
        can += detected(configs)
    if arguments.json:
        import msgspec

        print(msgspec.json.encode(as_object(serial, can)).decode())
        return 0
    for line in (*report(serial, can, why), *_names()):
        print(printable(line))
    return 0


def as_object(serial: Sequence[SerialAdapter], can: Sequence[CanInterface]) -> dict[str, Any]:
    """Return all that is known; what is not known is left out."""

    def known(entry: SerialAdapter | CanInterface) -> dict[str, Any]:
        return {"endpoint": entry.endpoint, **{k: v for k, v in asdict(entry).items() if v not in (None, "", ())}}

    return {"serial": [known(a) for a in serial], "can": [known(i) for i in can]}


def report(serial: Sequence[SerialAdapter], can: Sequence[CanInterface], why: str = "") -> Iterator[str]:
    """Yield the lines of the listing. `why`: why python-can's interfaces may have more."""
    yield "serial ports"
    for adapter in serial:
        yield from _serial(adapter)
    if not serial:
        yield from _NO_SERIAL.rstrip().splitlines()
    yield from _latency_advice(serial)
    yield "CAN interfaces"
    for interface in can:
        yield from _can(interface)
    if not can:
        yield from _NO_CAN.rstrip().splitlines()
    if why:
        yield f"  note: {why}"


def _names() -> Iterator[str]:
    """Yield what the names of a profile stand for."""
    known = profile.names()
    if known:
        yield "names (servotap.toml)"
    for name in dict.fromkeys(known):
        try:
            named = profile.look_up(name)
        except UsageError as error:
            yield f"  {name}  {error}"
            continue
        if named is not None:
            drives = ", ".join(each.text for each in named.drives)
            yield f"  {name}  {drives}{' on ' if drives else ''}{named.endpoint.text}"


def _serial(adapter: SerialAdapter) -> Iterator[str]:
    what = [adapter.chip]
    if adapter.product:
        what.append(f'"{adapter.product}"' + (f" of {adapter.maker}" if adapter.maker else ""))
    if adapter.vendor_id is not None:
        what.append(f"USB {adapter.vendor_id:04x}:{adapter.product_id or 0:04x}")
    if adapter.number:
        what.append(f"number {adapter.number}" + ("" if adapter.unique else " (not the only one that has it)"))
    yield f"  {adapter.path}  {', '.join(what)}"
    yield f"      endpoint    {adapter.endpoint}"
    if adapter.by_id:
        yield f"      lasting     {adapter.by_id}"
    if adapter.latency_ms is not None:
        late = " (bytes arrive in bursts, up to that late; 1 ms is best, see below)" if _is_slow(adapter) else ""
        yield f"      latency     timer at {adapter.latency_ms} ms{late}"
    if adapter.holders:
        yield f"      open by     {', '.join(adapter.holders)}: each byte reaches only one reader; see servotap tap"
    if not adapter.openable:
        yield f"      permission  {_permission(adapter)}"


def _permission(adapter: SerialAdapter) -> str:
    if not adapter.group:
        return "the port cannot be inspected"
    if adapter.group == "root":
        return f"none: only root may open it; a udev rule can give it to a group, or: sudo chmod a+rw {adapter.path}"
    return f"none: it is for the group {adapter.group}: sudo usermod -a -G {adapter.group} $USER, then log in again"


def _is_slow(adapter: SerialAdapter) -> bool:
    return adapter.latency_ms is not None and adapter.latency_ms > LOW_LATENCY_MS


def _latency_advice(serial: Sequence[SerialAdapter]) -> Iterator[str]:
    slow = [a for a in serial if _is_slow(a)]
    if not slow:
        return
    yield "  to lower a latency timer until the adapter is unplugged:"
    for adapter in slow:
        yield f"      echo 1 | sudo tee /sys/bus/usb-serial/devices/{os.path.basename(adapter.path)}/latency_timer"
    yield "  permanently:"
    yield f"      echo '{_UDEV_RULE}' | sudo tee {_RULES}"
    yield "      sudo udevadm control --reload, then unplug and plug"


def _can(interface: CanInterface) -> Iterator[str]:
    what = [interface.kind if not interface.driver else f"{interface.kind} ({interface.driver})"]
    what += [interface.adapter] if interface.adapter else []
    if interface.up is not None:
        what.append("up" if interface.up else "down")
    if interface.state:
        what.append(interface.state)
    if interface.bitrate:
        what.append(f"{interface.bitrate} bit/s")
    if interface.listen_only is not None:
        what.append("listen-only" if interface.listen_only else "not listen-only: it acknowledges frames")
    if interface.counters:
        what.append("errors: " + ", ".join(f"{name} {count}" for name, count in interface.counters.items()))
    yield f"  {interface.name}  {', '.join(what)}"
    yield f"      endpoint    {interface.endpoint}"
    if interface.up is False:
        speed = interface.bitrate or 500_000
        usual = f"type can bitrate {speed} listen-only on" if interface.kind != "vcan" else ""
        yield f"      to start    sudo ip link set {interface.name} up {usual}".rstrip()
    elif interface.listen_only is False and interface.kind == "can":
        name = interface.name
        yield f"      to only listen: sudo ip link set {name} down; sudo ip link set {name} up type can listen-only on"
