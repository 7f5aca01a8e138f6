"""Emulate drives on a serial port (a pseudo-terminal), a TCP port or a CAN bus, until Ctrl-C.

A drive is DIALECT@ADDRESS, with model, quirks, faults, speed and settings behind it. One line is printed when all is
ready: "listening on" and what clients open.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.cli.option_types import number
from analyzer.cli.output import apart
from analyzer.cli.signals import handled
from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.live.reader_port import Stop
from conformance.drives import make, realism
from conformance.drives.bus import Bus
from conformance.drives.can_bus import CanBus
from conformance.drives.drive import Drive
from conformance.drives.make import Specification
from conformance.drives.serial_bus import SerialBus
from conformance.drives.wire_faults import WireFaults, parse_rates
from conformance.serve.clock import Clock

if TYPE_CHECKING:
    from conformance.bus.can_port import CanPort
    from conformance.serve.serial_server import SerialPort

EXAMPLES = """\
examples:
  servotap emulate mks-rs485@1 --pty                          prints the terminal to open, as /dev/pts/5
  servotap emulate mks-rs485@1 mks-rs485@2,model=57D --pty /tmp/servo --set work_mode=sr_vfoc
  servotap emulate mks-modbus@1,baud=115200 --pty --state drive.json --log bus.mcap
  servotap emulate lk-rs485@3,fault=late-reply --tcp :5000    for pyserial's socket://127.0.0.1:5000
  servotap emulate mks-can@1 mks-can@2 --can udp_multicast:239.74.163.2,bitrate=500000
  servotap emulate mks-rs485@1,real=bench,latency-timer=16ms --pty       an honest drive as it is in the world
  servotap emulate arm --pty /tmp/arm                         a drive as a profile, servotap.toml, has it
  servotap emulate --list-faults
"""
SECOND_NS = 1_000_000_000
#: CAN frames that may wait for the bus: more than controllers and drivers keep, and less than half a second of traffic.
_ROOM = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "drives", nargs="*", metavar="DRIVE",
        help="DIALECT@ADDRESS[,model=M][,quirk=NAME][,fault=NAME][,real=bench|poor][,TRAIT=VALUE][,baud=N][,SETTING=VALUE]",
    )  # fmt: skip
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--pty", nargs="?", const="", metavar="LINK", help="a pseudo-terminal; LINK: a link to it")
    where.add_argument("--tcp", metavar="HOST:PORT", help="a TCP port; without HOST, loopback; port 0: a free one")
    where.add_argument("--can", metavar="INTERFACE:CHANNEL[,bitrate=N]", help="a python-can interface")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of measured noise and wire faults (default 0)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="settings",
        help="a start setting of all drives that have it, named as its command without set_: work_mode=5",
    )  # fmt: skip
    parser.add_argument("--state", metavar="FILE", help="keep settings between runs in FILE; --set overrides them")
    parser.add_argument("--log", metavar="OUT.mcap", help="log what goes over the bus, decoded")
    parser.add_argument("--force", action="store_true", help="replace a log that exists")
    parser.add_argument("--no-wire-time", action="store_true", help="bytes and frames take no time on the wire")
    delay = number("milliseconds from 0 to 60000", float, lambda ms: 0 <= ms < 60_000)
    parser.add_argument("--reply-delay", type=delay, metavar="MS", help="delay of a drive's reply")
    parser.add_argument("--echo", action="store_true", help="echo what the host sends, as some adapters do")
    parser.add_argument(
        "--wire-fault", action="append", default=[], metavar="KIND=RATE,...",
        help="faults of the wire: flip, drop, insert, pause for each byte; cut, collision for each sending",
    )  # fmt: skip
    seconds = number("seconds above 0", float, lambda s: 0 < s < 1e9)
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds")
    parser.add_argument("--list-quirks", action="store_true", help="list the quirks of real drives and where they were seen")
    parser.add_argument("--list-realism", action="store_true", help="list what honest drives and lines do, by trait")
    parser.add_argument("--list-faults", action="store_true", help="list the faults a drive can be given")


def run(arguments: argparse.Namespace) -> int:
    """Run the drives until they are told to end; return 0."""
    if arguments.list_quirks or arguments.list_faults or arguments.list_realism:
        if arguments.list_realism:
            _print_realism()
        if arguments.list_quirks:
            _print_changes(make.every_quirk(), lambda quirk: f"seen: {quirk.source}")
        if arguments.list_faults:
            _print_changes(make.every_fault(), lambda fault: f"breaks: {fault.breaks}")
        return 0
    _untangle(arguments)
    apart(arguments, "state", "log")
    specifications = [make.parse(named.text if (named := profile.drive(text)) else text) for text in arguments.drives]
    _check(specifications, arguments)
    with contextlib.ExitStack() as stack:
        _emulate(specifications, arguments, stack)
    return 0


def _print_changes(changes: Sequence[Any], last: Callable[[Any], str]) -> None:
    for change in changes:
        print(f"{change.name}  ({', '.join(change.dialects)})\n    {change.text}\n    {last(change)}")


def _print_realism() -> None:
    for trait in realism.TRAITS:
        written = f"{trait.name}={trait.example}" if trait.unit else trait.name
        where = "  (serial lines)" if trait.serial else ""
        print(f"{written}{where}\n    {trait.touches}\n    unit: {trait.unit or 'none'}; from: {trait.source}")
    for name, traits in realism.SETS.items():
        print(f"real={name}\n    " + ",".join(f"{n}={value}" if value else n for n, value in traits.items()))


def _untangle(arguments: argparse.Namespace) -> None:
    """Take a drive that stands where --pty could have its link for the drive that it is."""
    link = arguments.pty
    if link and "@" in link and link.partition("@")[0] in registry.names():
        arguments.drives.append(link)
        arguments.pty = ""


def _check(specifications: Sequence[Specification], arguments: argparse.Namespace) -> None:
    if not specifications:
        raise UsageError("expected at least one DRIVE, as in mks-rs485@1")
    if arguments.pty is None and arguments.tcp is None and arguments.can is None:
        raise UsageError("where? expected --pty, --tcp HOST:PORT or --can INTERFACE:CHANNEL")
    kind = "can" if arguments.can is not None else "serial"
    for specification in specifications:
        if specification.dialect.bus != kind:
            option = "--can" if kind == "can" else "--pty" if arguments.pty is not None else "--tcp"
            raise UsageError(f"{specification.name} is a drive on {specification.dialect.bus}, which {option} is not")
    if arguments.echo and kind == "can":
        raise UsageError("--echo is of serial adapters; on CAN a host's controller decides that")


def _emulate(specifications: Sequence[Specification], arguments: argparse.Namespace, stack: contextlib.ExitStack) -> None:
    from conformance.serve.log import BusLog
    from conformance.serve.state import StateFile, claimed, load

    if arguments.state:
        stack.enter_context(claimed(arguments.state))
    kept = load(arguments.state) if arguments.state else {}
    drives = _drives(specifications, arguments, kept)
    faults = _wire_faults(arguments)
    bus: SerialBus | CanBus
    wire_time = not arguments.no_wire_time
    if arguments.can is not None:
        bus = CanBus(list(drives.values()), wire_time=wire_time, room=_ROOM, faults=faults)
    else:
        bus = SerialBus(list(drives.values()), wire_time=wire_time, echo=arguments.echo, faults=faults)
    # The signals are taken over before anything is opened, so that all of it is closed again.
    stop = Stop()
    stack.callback(stop.close)

    def ask_to_end(number: int, frame: object) -> None:
        if stop.asked:
            # A driver that hangs does not look at the first wish.
            raise KeyboardInterrupt
        stop.ask("a signal")

    stack.enter_context(handled(ask_to_end))
    place = _open(bus, arguments)
    stack.callback(place.port.close)
    clock = Clock()
    ticks: list[Callable[[int], None]] = []
    if arguments.state:
        state = StateFile(arguments.state, drives)
        state.save()
        stack.callback(state.save)
        ticks.append(lambda now_ns: state.save())
    if arguments.log:
        log = BusLog.of(bus, arguments.log, _dialects(specifications), anchor_ns=clock.anchor_ns, force=arguments.force)
        about = {"source": "emulated drives: " + " ".join(arguments.drives), "seed": str(arguments.seed)}
        stack.callback(log.finish, about)
        ticks.append(log.tick)

    def tick(now_ns: int) -> None:
        for each in ticks:
            each(now_ns)

    _say_speeds(bus, arguments)
    # What is there now stays: a full collection over the catalogues would delay a reply by milliseconds.
    gc.collect()
    gc.freeze()
    print(f"listening on {place.port.name}", flush=True)
    until_ns = None if arguments.duration is None else int(arguments.duration * SECOND_NS)
    place.serve(clock, stop, until_ns=until_ns, tick=tick)
    _say_end(bus, faults, place.port.lost)


def _drives(
    specifications: Sequence[Specification], arguments: argparse.Namespace, kept: Mapping[str, Mapping[str, int]]
) -> dict[str, Drive]:
    """Return the drives by the names under which they are kept; a second one of a name gets a number."""
    given = make.start_settings(specifications, make.parse_settings(arguments.settings))
    delay_ns = None if arguments.reply_delay is None else int(arguments.reply_delay * 1e6)
    drives: dict[str, Drive] = {}
    for specification, settings in zip(specifications, given, strict=True):
        name, number = specification.name, 2
        while name in drives:
            name, number = f"{specification.name}#{number}", number + 1
        whole = dict(kept.get(name, {})) | settings
        try:
            drives[name] = make.make(specification, settings=whole, seed=arguments.seed, reply_delay_ns=delay_ns)
        except UsageError as error:
            if name in kept:
                raise UsageError(f"{name}, as {arguments.state} keeps it: {error}") from None
            raise
    return drives


def _wire_faults(arguments: argparse.Namespace) -> WireFaults | None:
    rates: dict[str, float] = {}
    for text in arguments.wire_fault:
        rates |= parse_rates(text)
    return WireFaults(rates, arguments.seed) if rates else None


def _dialects(specifications: Sequence[Specification]) -> list[Dialect]:
    """Return what may be spoken on the bus, as the drives' model speaks it where all of a dialect are of one."""
    names = list(dict.fromkeys(s.dialect.name for s in specifications))
    # A drive can be told to speak another one.
    names += dict.fromkeys(s for name in tuple(names) for s in registry.get(name).siblings if s not in names)
    models = {s.model for s in specifications}
    model = models.pop() if len(models) == 1 else ""
    found = [registry.get(name) for name in names]
    return [d.for_model(model) if model in d.models else d for d in found]


class _Place(NamedTuple):
    """A port that is open, and what runs a bus on it."""

    port: SerialPort | CanPort
    serve: Callable[..., None]


def _open(bus: SerialBus | CanBus, arguments: argparse.Namespace) -> _Place:
    if isinstance(bus, CanBus):
        from conformance.bus import open_can_port
        from conformance.serve import can

        interface, channel, options = can.parse_endpoint(arguments.can)
        on_can = open_can_port(interface, channel, **options)
        bus.speed = on_can.bitrate
        return _Place(on_can, partial(can.serve, bus, on_can))
    from conformance.serve import serial_server

    port = _serial_port(bus, arguments)
    return _Place(port, partial(serial_server.serve, bus, port))


def _serial_port(bus: SerialBus, arguments: argparse.Namespace) -> SerialPort:
    if arguments.tcp is not None:
        from conformance.serve.tcp import TcpPort, parse_endpoint

        return TcpPort(*parse_endpoint(arguments.tcp), partial(print, file=sys.stderr, flush=True))
    try:
        from conformance.serve.pty import PtyPort
    except ImportError:
        raise UsageError("this system has no pseudo-terminals; use --tcp HOST:PORT") from None
    return PtyPort(arguments.pty, speed=bus.stations[0].speed)


def _say_speeds(bus: Bus, arguments: argparse.Namespace) -> None:
    """Say so on standard error where a host cannot reach all drives at one speed."""
    speeds = {station.name: station.speed for station in bus.stations}
    listed = ", ".join(f"{name} at {speed}" for name, speed in speeds.items())
    if arguments.pty is not None and len(set(speeds.values())) > 1:
        print(f"servotap emulate: drives at different speeds: {listed} (baud=N sets one)", file=sys.stderr)
    if bus.speed is not None and set(speeds.values()) != {bus.speed}:
        print(f"servotap emulate: the bus is at {bus.speed}, {listed} (bitrate=N sets one)", file=sys.stderr)


def _say_end(bus: Bus, faults: WireFaults | None, lost: int) -> None:
    """Say on standard error what a user should know of the run."""
    told = []
    if bus.collisions:
        told.append(f"{bus.collisions} collisions")
    if isinstance(bus, CanBus) and bus.overrun:
        told.append(f"{bus.overrun} frames came faster than the bus carries them, and were lost")
    if lost:
        told.append(f"{lost} bytes or frames that no client took")
    if faults is not None:
        told += [f"{count} x {kind}" for kind, count in faults.struck.items() if count]
    if told:
        print(f"servotap emulate: {', '.join(told)}", file=sys.stderr)
