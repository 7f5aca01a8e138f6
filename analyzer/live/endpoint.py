"""Where a bus is: one way of naming it for every command.

    [NAME=]serial:PORT[,baud=N|auto][,parity=none|even|odd][,stop=1|2][,serial=NUMBER][,direction=request|reply]
    [NAME=]tcp:HOST:PORT[,baud=N]
    [NAME=]can:INTERFACE:CHANNEL[,bitrate=N][,OPTION=VALUE...]

    left=serial:/dev/ttyUSB0,baud=38400      arm=can:slcan:/dev/ttyACM0,bitrate=500000      tcp:192.168.0.7:5000

NAME is the bus in the topics of a log; without it, it is made from the port. Two endpoints of one NAME are the two
directions of one line. Nothing here needs quoting in a shell, and nothing is opened here.

Rules: an option that is not known is refused, but for CAN, where python-can's interfaces have options of their own. A
serial adapter may be named by its serial number (`serial:,serial=A50285BI`), which stays when ports are renumbered.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from analyzer.catalogue import Dialect, Role
from analyzer.errors import UsageError
from analyzer.values import is_host, quote

#: Baud rate of a serial line where none is given: the default of the MKS drives.
DEFAULT_BAUD = 38400
#: Bit rate of a CAN bus where none is given.
DEFAULT_BITRATE = 500_000
PARITIES: Mapping[str, str] = {"none": "N", "even": "E", "odd": "O", "N": "N", "E": "E", "O": "O"}
_NAMED = re.compile(r"(?P<name>[A-Za-z0-9_.-]+)=(?P<rest>(?:serial|tcp|can):.*)", re.DOTALL)
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")
_HOST_PORT = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.%]+\]|[^:\[\]]*):)?(?P<port>[0-9]{1,5})")
_EXPECTED = (
    "expected serial:PORT,baud=N, tcp:HOST:PORT or can:INTERFACE:CHANNEL,bitrate=N, as in serial:/dev/ttyUSB0,baud=38400"
)


@dataclass(frozen=True)
class Endpoint:
    """A bus as it was named.

    `kind`: `serial`, `tcp` or `can`. `place`: the port's path, HOST:PORT, or INTERFACE:CHANNEL. `name`: the bus.
    `speed`: bits per second, None where it was not given; `auto`: it is to be found out. `direction`: who is heard on
    this one, where each direction has an endpoint of its own. `adapter`: serial number of the USB adapter, or "".
    `options`: what a CAN interface is given besides.
    """

    text: str
    kind: str
    place: str
    name: str
    speed: int | None = None
    auto: bool = False
    parity: str = "N"
    stop_bits: int = 1
    adapter: str = ""
    direction: Role = Role.UNKNOWN
    options: Mapping[str, int | float | str] = field(default_factory=dict)

    @property
    def bus_kind(self) -> str:
        """`can` or `serial`, as a dialect's `bus`."""
        return "can" if self.kind == "can" else "serial"

    def check_dialect(self, dialect: Dialect) -> None:
        """Raise UsageError for a dialect of another kind of bus."""
        if dialect.bus != self.bus_kind:
            raise UsageError(f"{dialect.name} is a dialect of {dialect.bus}, and {self.text} is a {self.bus_kind} bus")

    @property
    def host(self) -> tuple[str, int]:
        """Host and port of a `tcp` endpoint."""
        host, _, port = self.place.rpartition(":")
        return host.strip("[]"), int(port)

    @property
    def interface(self) -> tuple[str, str]:
        """Interface and channel of a `can` endpoint."""
        interface, _, channel = self.place.partition(":")
        return interface, channel

    @property
    def bits_per_second(self) -> int:
        """The speed, or the usual one where none was given."""
        return self.speed or (DEFAULT_BITRATE if self.kind == "can" else DEFAULT_BAUD)

    @property
    def bits_per_byte(self) -> int:
        """Bits that a byte takes on a serial line: start, eight data bits, parity, stop."""
        return 9 + self.stop_bits + (self.parity != "N")

    @property
    def byte_ns(self) -> int:
        """Time of one byte on a serial line in nanoseconds; 0 over TCP without `baud`, where no line speed is known."""
        if self.kind == "can" or (self.kind == "tcp" and self.speed is None):
            return 0
        return self.bits_per_byte * 1_000_000_000 // self.bits_per_second

    def at(self, speed: int) -> Endpoint:
        """Return this endpoint at another speed."""
        return replace(self, speed=speed, auto=False)

    def __str__(self) -> str:
        return self.text


def parse(text: str) -> Endpoint:
    """Return the endpoint that a text names.

    Raises UsageError that says what was expected.
    """
    named = _NAMED.fullmatch(text)
    name, rest = (named["name"], named["rest"]) if named else ("", text)
    kind, colon, rest = rest.partition(":")
    if not colon or kind not in _KINDS:
        raise UsageError(f"got {quote(text)}, {_EXPECTED}")
    place, *parts = rest.split(",")
    options: dict[str, str] = {}
    for part in parts:
        key, equals, value = part.partition("=")
        if not equals or not key.isidentifier() or not value:
            raise UsageError(f"{quote(text)}: got {quote(part)}, expected NAME=VALUE, as in baud=38400")
        if key in options:
            raise UsageError(f"{quote(text)}: {key} stands there twice")
        options[key] = value
    endpoint = _KINDS[kind](text, place, options)
    return replace(endpoint, name=name or _default_name(endpoint))


def parse_all(texts: Sequence[str]) -> list[Endpoint]:
    """Return the endpoints of several texts, with names that differ unless the user gave the same to two directions.

    Raises UsageError, also for two endpoints of one name that are not the two directions of one serial line.
    """
    if not texts:
        raise UsageError(f"no endpoint given, {_EXPECTED}")
    found: list[Endpoint] = []
    for text in texts:
        endpoint = parse(text)
        same = [e for e in found if e.name == endpoint.name]
        if same and not _NAMED.fullmatch(text):
            number = 2
            while any(e.name == f"{endpoint.name}_{number}" for e in found):
                number += 1
            endpoint = replace(endpoint, name=f"{endpoint.name}_{number}")
        elif same:
            directions = {e.direction for e in (*same, endpoint)}
            if len(same) > 1 or directions != {Role.REQUEST, Role.REPLY} or endpoint.bus_kind == "can":
                raise UsageError(
                    f"two endpoints are named {endpoint.name}: give another name, or direction=request to one and "
                    "direction=reply to the other where they are the two directions of one serial line"
                )
        if any(e.kind == endpoint.kind and e.place == endpoint.place and e.adapter == endpoint.adapter for e in found):
            raise UsageError(f"{endpoint.kind}:{endpoint.place} stands there twice")
        found.append(endpoint)
    return found


def _serial(text: str, place: str, options: dict[str, str]) -> Endpoint:
    adapter = options.pop("serial", "")
    if not place and not adapter:
        raise UsageError(f"{quote(text)}: no port, expected serial:PORT or serial:,serial=NUMBER of the adapter")
    parity = options.pop("parity", "none")
    if parity not in PARITIES:
        raise UsageError(f"{quote(text)}: parity: got {quote(parity)}, expected none, even or odd")
    stop = options.pop("stop", "1")
    if stop not in ("1", "2"):
        raise UsageError(f"{quote(text)}: stop: got {quote(stop)}, expected 1 or 2 stop bits")
    direction = _direction(text, options)
    baud = options.pop("baud", None)
    auto = baud == "auto"
    speed = None if auto or baud is None else _speed(text, "baud", baud, "bits per second or auto")
    _refuse_rest(text, options, ("baud", "parity", "stop", "serial", "direction"))
    return Endpoint(text, "serial", place, "", speed, auto, PARITIES[parity], int(stop), adapter, direction)


def _tcp(text: str, place: str, options: dict[str, str]) -> Endpoint:
    match = _HOST_PORT.fullmatch(place)
    if match is None or not 0 < int(match["port"]) <= 0xFFFF or not is_host(match["host"] or ""):
        raise UsageError(f"{quote(text)}: got {quote(place)}, expected tcp:HOST:PORT with a port 1..65535")
    baud = options.pop("baud", None)
    speed = None if baud is None else _speed(text, "baud", baud)
    direction = _direction(text, options)
    _refuse_rest(text, options, ("baud", "direction"))
    host = match["host"] or "127.0.0.1"
    return Endpoint(text, "tcp", f"{host}:{int(match['port'])}", "", speed, direction=direction)


def _can(text: str, place: str, options: dict[str, str]) -> Endpoint:
    interface, colon, channel = place.partition(":")
    if not colon or not interface or not channel:
        raise UsageError(f"{quote(text)}: got {quote(place)}, expected can:INTERFACE:CHANNEL, as in can:socketcan:can0")
    for taken in ("interface", "channel"):
        if taken in options:
            raise UsageError(f"{quote(text)}: {taken} stands before the options, expected can:INTERFACE:CHANNEL")
    rate = options.pop("bitrate", None)
    speed = None if rate is None else _speed(text, "bitrate", rate)
    rest = {key: value_of(value) for key, value in options.items()}
    return Endpoint(text, "can", f"{interface}:{channel}", "", speed, options=rest)


_KINDS = {"serial": _serial, "tcp": _tcp, "can": _can}


def _speed(text: str, name: str, value: str, wanted: str = "bits per second") -> int:
    try:
        speed = int(value)
    except ValueError:
        speed = 0
    if not 0 < speed <= 100_000_000:
        raise UsageError(f"{quote(text)}: {name}: got {quote(value)}, expected {wanted}")
    return speed


def _direction(text: str, options: dict[str, str]) -> Role:
    direction = options.pop("direction", "unknown")
    if direction not in ("request", "reply", "unknown"):
        raise UsageError(f"{quote(text)}: direction: got {quote(direction)}, expected request or reply")
    return Role(direction)


def _refuse_rest(text: str, options: Mapping[str, str], known: Sequence[str]) -> None:
    if options:
        raise UsageError(f"{quote(text)}: no option {quote(next(iter(options)))}, expected {', '.join(known)}")


def value_of(text: str) -> int | float | str:
    """Return the value of an option of python-can's interfaces: a number where it is one."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _default_name(endpoint: Endpoint) -> str:
    """Return a name of a bus from its port: ttyUSB0, can0, 127.0.0.1_5000."""
    if endpoint.kind == "can":
        interface, channel = endpoint.interface
        text = channel.rsplit("/", 1)[-1] if not channel.isdigit() else f"{interface}{channel}"
    elif endpoint.kind == "tcp":
        text = endpoint.place
    else:
        path = endpoint.place or endpoint.adapter
        # A pseudo-terminal is known by its number alone.
        text = path.removeprefix("/dev/").replace("/", "") if path.startswith("/dev/pts/") else path.rsplit("/", 1)[-1]
    return _UNFIT.sub("_", text).strip("_") or endpoint.kind
