"""The serial ports and CAN interfaces of a machine, with all that matters for listening to them.

    /sys/class/tty/ttyUSB0 -> device -> ... -> USB device with idVendor, idProduct, serial
    /sys/class/net/can0      type 280 is CAN; `ip -json -details` tells its state

Nothing is opened here, so nothing is disturbed: all of it stands in sysfs, in /proc and in what `ip` prints. On systems
without sysfs pyserial's list of ports is given, which knows less. `root` is where these trees stand, for tests.

Not known here: processes of other users that hold a port (only root sees them), and adapters without a loaded driver.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from analyzer.live.adapter_chips import chip_of, speaks_slcan

ROOT = Path("/")
#: Type of a network interface that is a CAN bus (ARPHRD_CAN).
_CAN_TYPE = "280"
#: Type of a built-in port that is only a place for one (PORT_UNKNOWN).
_NO_PORT = "0"
#: From here on up a latency timer is worth lowering, in ms.
LOW_LATENCY_MS = 1
_IP_TIMEOUT_S = 5.0
#: What an endpoint may hold without quoting in a shell.
_PLAIN = re.compile(r"[A-Za-z0-9_./:+-]+")
#: Levels between a port and its USB device, and some more.
_DEPTH = 12


@dataclass(frozen=True)
class SerialAdapter:
    """A serial port.

    `path`: to open; `by_id`: a link that stays when ports are renumbered, or "". `chip`: what the adapter is; `driver`: of
    the kernel, or "". `vendor_id`, `product_id`: of USB, None on others; `number`: the adapter's serial number, or "".
    `latency_ms`: of its latency timer, None where it has none. `holders`: processes that have it open, as far as can be
    seen. `openable`: whether this user may read it; `group`: whose it is. `slcan`: a CAN adapter behind a serial port.
    `unique`: no other port has this serial number.
    """

    path: str
    chip: str
    by_id: str = ""
    driver: str = ""
    vendor_id: int | None = None
    product_id: int | None = None
    maker: str = ""
    product: str = ""
    number: str = ""
    latency_ms: int | None = None
    holders: tuple[str, ...] = ()
    openable: bool = True
    group: str = ""
    slcan: bool = False
    unique: bool = True

    @property
    def endpoint(self) -> str:
        """The endpoint to paste: by what stays the same when the adapter is plugged in elsewhere, as far as it has that."""
        if self.slcan:
            return f"can:slcan:{self.by_id or self.path},bitrate=500000"
        if self.number and self.unique and _PLAIN.fullmatch(self.number):
            return f"serial:,serial={self.number},baud=auto"
        place = self.by_id if self.by_id and _PLAIN.fullmatch(self.by_id) else self.path
        return f"serial:{place},baud=auto"


@dataclass(frozen=True)
class CanInterface:
    """A CAN interface.

    `name`: of the network interface, or INTERFACE:CHANNEL of python-can. `kind`: can, vcan, ... or python-can's interface.
    `up`: None if unknown. `state`: of the controller, as ERROR-ACTIVE. `bitrate`: bits per second. `listen_only`:
    None where it cannot be told. `counters`: of errors, by name.
    """

    name: str
    kind: str
    endpoint: str
    driver: str = ""
    adapter: str = ""
    up: bool | None = None
    state: str = ""
    bitrate: int | None = None
    listen_only: bool | None = None
    counters: Mapping[str, int] | None = None


# --- serial ports ---------------------------------------------------------------------------------------------------


def serial_adapters(root: Path = ROOT) -> list[SerialAdapter]:
    """Return the serial ports, those of USB adapters first."""
    tree = root / "sys/class/tty"
    found = list(_by_sysfs(root, tree) if tree.is_dir() else _by_pyserial())
    holders = _holders(root, [a.path for a in found])
    numbers = Counter(a.number for a in found)
    told = [replace(a, holders=tuple(holders.get(a.path, ())), unique=numbers[a.number] == 1) for a in found]
    return sorted(told, key=lambda a: (a.vendor_id is None, _natural(a.path)))


def _natural(text: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", text)]


def _by_sysfs(root: Path, tree: Path) -> Iterator[SerialAdapter]:
    links = _by_id(root)
    for entry in sorted(tree.iterdir()):
        device = entry / "device"
        # Consoles and pseudo-terminals have no device; a place for a built-in port without one has no type.
        if not device.exists() or _text(entry / "type") == _NO_PORT:
            continue
        driver = os.path.basename(os.path.realpath(device / "driver")) if (device / "driver").exists() else ""
        usb = _usb_device(device)
        vendor, product = (_hex(usb / "idVendor"), _hex(usb / "idProduct")) if usb is not None else (None, None)
        path = f"/dev/{entry.name}"
        group, openable = _permission(root / path[1:])
        yield SerialAdapter(
            path=path,
            chip=chip_of(vendor, product, driver),
            by_id=links.get(entry.name, ""),
            driver=driver,
            vendor_id=vendor,
            product_id=product,
            maker=_text(usb / "manufacturer") if usb is not None else "",
            product=_text(usb / "product") if usb is not None else "",
            number=_text(usb / "serial") if usb is not None else "",
            latency_ms=_number(device / "latency_timer"),
            openable=openable,
            group=group,
            slcan=speaks_slcan(vendor, product),
        )


def _by_pyserial() -> Iterator[SerialAdapter]:
    from serial.tools.list_ports import comports

    for port in comports():
        yield SerialAdapter(
            path=port.device,
            chip=chip_of(port.vid, port.pid, ""),
            vendor_id=port.vid,
            product_id=port.pid,
            maker=port.manufacturer or "",
            product=port.product or port.description or "",
            number=port.serial_number or "",
            slcan=speaks_slcan(port.vid, port.pid),
        )


def _usb_device(device: Path) -> Path | None:
    """Return the USB device that a port belongs to, None for a port that is none of USB."""
    place = Path(os.path.realpath(device))
    for _ in range(_DEPTH):
        if (place / "idVendor").is_file():
            return place
        place = place.parent
    return None


def _by_id(root: Path) -> dict[str, str]:
    """Return the lasting links of ports, by the port's name."""
    folder = root / "dev/serial/by-id"
    if not folder.is_dir():
        return {}
    links = [link for link in folder.iterdir() if link.is_symlink()]
    return {os.path.basename(os.readlink(link)): f"/dev/serial/by-id/{link.name}" for link in links}


def _permission(path: Path) -> tuple[str, bool]:
    """Return whose group a port is, and whether this user may read it."""
    try:
        number = path.stat().st_gid
    except OSError:
        return "", False
    try:
        import grp

        group = grp.getgrgid(number).gr_name
    except (ImportError, KeyError):
        group = str(number)
    return group, os.access(path, os.R_OK)


def _holders(root: Path, paths: Sequence[str]) -> dict[str, list[str]]:
    """Return the processes that have ports open, by port, as far as this user may see."""
    wanted = set(paths)
    found: dict[str, list[str]] = {}
    for process in (root / "proc").glob("[0-9]*") if wanted else ():
        try:
            opened = {os.readlink(entry.path) for entry in os.scandir(process / "fd")}
        except OSError:
            # Another user's process, or one that ended meanwhile.
            continue
        for path in sorted(wanted & opened):
            found.setdefault(path, []).append(f"{_text(process / 'comm') or 'a program'} (process {process.name})")
    return found


# --- CAN interfaces -------------------------------------------------------------------------------------------------


def can_interfaces(root: Path = ROOT, ip: str | None = None) -> list[CanInterface]:
    """Return the CAN interfaces of SocketCAN. `ip`: what `ip -json -details link show` printed; None: ask it."""
    tree = root / "sys/class/net"
    if not tree.is_dir():
        return []
    names = [e.name for e in sorted(tree.iterdir(), key=lambda e: _natural(e.name)) if _text(e / "type") == _CAN_TYPE]
    if not names:
        return []
    links = links_of(ask_ip() if ip is None else ip)
    return [_socketcan(tree / name, links.get(name, {})) for name in names]


def links_of(text: str) -> dict[str, dict[str, Any]]:
    """Return the interfaces in what `ip -json -details link show` printed, by name; none if it is no such text."""
    try:
        listed = json.loads(text or "[]")
    except ValueError:
        return {}
    return {link["ifname"]: link for link in listed if isinstance(link, dict) and "ifname" in link}


def ask_ip() -> str:
    """Return what `ip` tells of all network interfaces as JSON; empty where it cannot be asked."""
    program = shutil.which("ip") or shutil.which("ip", path="/usr/sbin:/sbin")
    if program is None:
        return ""
    try:
        words = [program, "-json", "-details", "-statistics", "link", "show"]
        return subprocess.run(words, capture_output=True, text=True, timeout=_IP_TIMEOUT_S, check=False).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _socketcan(entry: Path, link: Mapping[str, Any]) -> CanInterface:
    about = link.get("linkinfo") or {}
    data = about.get("info_data") or {}
    bitrate = (data.get("bittiming") or {}).get("bitrate") or data.get("bittiming_bitrate")
    driver = os.path.basename(os.path.realpath(entry / "device/driver")) if (entry / "device/driver").exists() else ""
    usb = _usb_device(entry / "device") if (entry / "device").exists() else None
    virtual = not (entry / "device").exists()
    kind = about.get("info_kind") or ("vcan" if virtual else "can")
    modes = data.get("ctrlmode")
    return CanInterface(
        name=entry.name,
        kind=kind,
        endpoint=f"can:socketcan:{entry.name}" + (f",bitrate={bitrate}" if bitrate else ""),
        driver=driver,
        adapter=" ".join(filter(None, (_text(usb / "product"), _text(usb / "serial")))) if usb is not None else "",
        up="UP" in link["flags"] if "flags" in link else _text(entry / "operstate") in ("up", "unknown"),
        state=data.get("state", ""),
        bitrate=bitrate,
        # Without any mode the list is left out.
        listen_only="LISTEN-ONLY" in (modes or ()) if data else None,
        counters=_counters(entry, about, data),
    )


def _counters(entry: Path, about: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, int]:
    """Return what counts errors: the controller's own two counters, then what has happened so far, zeros left out."""
    own = {f"{name}_errors": count for name, count in (data.get("berr_counter") or {}).items()}
    risen = dict(about.get("info_xstats") or {})
    for name in ("rx_dropped", "rx_over_errors", "tx_dropped"):
        risen[name] = _number(entry / "statistics" / name) or 0
    return own | {name: count for name, count in risen.items() if count}


# --- reading sysfs --------------------------------------------------------------------------------------------------


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _number(path: Path) -> int | None:
    text = _text(path)
    return int(text) if text.isdigit() else None


def _hex(path: Path) -> int | None:
    try:
        return int(_text(path), 16)
    except ValueError:
        return None


def detected(configs: Iterable[Mapping[str, Any]]) -> list[CanInterface]:
    """Return the interfaces in python-can's list of configurations, in the words of an endpoint."""
    found = []
    for config in configs:
        rest = dict(config)
        interface, channel = str(rest.pop("interface", "")), rest.pop("channel", None)
        if not interface or channel is None:
            continue
        plain = {k: v for k, v in rest.items() if isinstance(v, int | float | str) and _PLAIN.fullmatch(str(v))}
        options = "".join(f",{name}={value}" for name, value in plain.items())
        name = f"{interface}:{channel}"
        found.append(CanInterface(name, interface, f"can:{name}{options}"))
    return found
