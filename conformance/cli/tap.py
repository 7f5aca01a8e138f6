"""Stand between a program and its serial adapter, and record both directions.

The program opens the link instead of the adapter; bytes pass both ways unchanged, at the speed that the program sets. It
sends only what the program sends, so nothing is asked or allowed here. Ctrl-C ends it, and the program's port with it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from analyzer.catalogue import Role
from analyzer.cli.option_types import utf8
from analyzer.cli.record import add_recording_arguments, asked_duration_ns, configure, display_of, record, target_of
from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import Unopened, find_adapter

if TYPE_CHECKING:
    from analyzer.live.children import Child, MessageQueue
    from conformance.serve.pty import PtyPort

EXAMPLES = """\
endpoints:
  [NAME=]serial:PORT[,baud=N][,parity=even]        baud is the speed until the program sets one
  [NAME=]serial:,serial=NUMBER                     a USB adapter by its serial number
  [NAME=]tcp:HOST:PORT                             a serial server
  NAME                                             a bus or a drive of a profile, servotap.toml

examples:
  servotap tap serial:/dev/ttyUSB0 --link /tmp/ttyDRIVE
  servotap tap left=serial:/dev/ttyUSB0,baud=115200 --link ~/ttyLEFT -o left.mcap --view
  servotap tap serial:/dev/ttyUSB0 --link /tmp/ttyDRIVE --rs485      RTS keys the transmitter
  then, in another terminal:  python my_program.py --port /tmp/ttyDRIVE

what passes, and what cannot: speed, stop bits and odd parity are followed; a pseudo-terminal does not tell even parity,
so that has to stand in the endpoint (parity=even). RTS, DTR, breaks and modem lines do not pass: --rts, --dtr, --rs485.

exit status: 0 the log has all traffic, 1 traffic was lost (see the summary), 2 wrong use, or its output could not be
written (the log is kept)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("endpoint", type=utf8, metavar="[NAME=]ENDPOINT", help="the adapter, see below")
    parser.add_argument("--link", required=True, metavar="PATH", help="where the program finds its port: a link to it is made")
    for line in ("rts", "dtr"):
        parser.add_argument(
            f"--{line}", choices=("on", "off", "leave"), default="leave",
            help=f"{line.upper()} of the adapter (default leave: as the kernel sets it at opening)",
        )  # fmt: skip
    parser.add_argument("--rs485", action="store_true", help="the driver raises RTS while it sends, where it can")
    add_recording_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Pass and record until the end is asked for; return 0, or 1 if something was lost."""
    display = display_of(arguments, "tap")
    endpoint = _endpoint(arguments.endpoint)
    _refuse_own_port(arguments.link, endpoint)
    target = target_of(arguments)
    notes = [] if endpoint.speed else [f"{endpoint.name}: {endpoint.bits_per_second} baud until the program sets a speed"]
    directions = [replace(endpoint, direction=role) for role in (Role.REQUEST, Role.REPLY)]
    notes.append(f"tapped: the program's port was {arguments.link}")
    named = profile.look_up(arguments.endpoint)
    config = configure(arguments, directions, target, notes, [named] if named is not None else [])
    stems = (config.ports[0].stem, config.ports[1].stem)
    with _terminal(arguments.link, endpoint) as port:
        ends = (port.descriptors()[0], port.slave)
        print(f"servotap tap: {port.name} is the program's port (it leads to {port.path})", file=sys.stderr, flush=True)

        def readers(folder: Path, heard: MessageQueue) -> Mapping[str, Child]:
            from analyzer.live.children import PYTHON, READER_NICE, StoringChild

            command = [*PYTHON, "-m", "conformance.tap.process", str(folder), *stems, "--terminal", *map(str, ends)]
            # One reader stores both directions of the bus, and bears the name of the second.
            return {stems[1]: StoringChild(stems[1], [*command, *_options(arguments)], heard, READER_NICE, ends)}

        duration_ns = asked_duration_ns(arguments)
        return record(
            config, display, duration_ns=duration_ns, readers=readers, replaces=arguments.replaces, names=arguments.names
        )


def _endpoint(text: str) -> Endpoint:
    endpoint = profile.endpoint(text)
    if endpoint.kind == "can":
        raise UsageError("a tap is for serial lines; on CAN several can listen: servotap record")
    if endpoint.direction is not Role.UNKNOWN:
        raise UsageError(f"{text}: a tap knows both directions; direction= is for servotap record")
    # The program sets the speed.
    return replace(endpoint, auto=False)


def _refuse_own_port(link: str, endpoint: Endpoint) -> None:
    """Raise UsageError where the link names the adapter's own device; one device may have several names."""
    port = endpoint.place if endpoint.kind == "serial" else ""
    if endpoint.adapter:
        # Where it is not plugged in, the tap waits for it.
        with contextlib.suppress(Unopened):
            port = find_adapter(endpoint.adapter)
    if port and (os.path.realpath(port) == os.path.realpath(link) or _is_device(port, link)):
        raise UsageError(
            f"--link {link} is the adapter's port, {endpoint.text}: give the program another name, as in --link /tmp/ttyDRIVE"
        )


def _is_device(one: str, other: str) -> bool:
    """Say whether two names are of one device."""
    try:
        found = [os.stat(name) for name in (one, other)]
    except OSError:
        return False
    return all(stat.S_ISCHR(each.st_mode) for each in found) and found[0].st_rdev == found[1].st_rdev


@contextlib.contextmanager
def _terminal(link: str, endpoint: Endpoint) -> Iterator[PtyPort]:
    """Offer a pseudo-terminal that is set up as the endpoint says, for the time of this."""
    if os.name != "posix":
        raise UsageError("this system has no pseudo-terminals to put between a program and its adapter")
    from conformance.serve.pty import PtyPort
    from conformance.tap.settings import of_endpoint, set_terminal

    port = PtyPort(link)
    try:
        set_terminal(port.slave, of_endpoint(endpoint))
        yield port
    finally:
        port.close()


def _options(arguments: argparse.Namespace) -> Sequence[str]:
    words = ["--link", os.path.abspath(arguments.link), "--rts", arguments.rts, "--dtr", arguments.dtr]
    return [*words, "--rs485"] if arguments.rs485 else words
