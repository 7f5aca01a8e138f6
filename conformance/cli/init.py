"""Write a profile, servotap.toml, with the drives that answer on some buses. A name then stands for an endpoint or a drive.

It looks as `servotap scan` does, with reads only. A profile that exists is kept, unless --force says otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from analyzer.cli.output import free_target, write_whole
from analyzer.cli.signals import ended_status
from analyzer.errors import UsageError
from analyzer.live import endpoint as endpoints
from analyzer.live import profile
from analyzer.live.endpoint import Endpoint
from conformance.cli.scan import add_looking_arguments, look, show, without_rate
from conformance.talk.scan import Found

EXAMPLES = """\
exit status: 0 written, 1 no drive answered and nothing was written, 2 wrong use,
130 Ctrl-C, 143 SIGTERM: the drives that were found by then are written.

examples:
  servotap init serial:/dev/ttyUSB0                          drive1, drive2, ... by their addresses
  servotap init arm=serial:/dev/ttyUSB0,baud=38400           one drive is named arm, several arm_1, arm_2 ...
  servotap init left=serial:/dev/ttyUSB0 right=can:socketcan:can0 --addresses 1-8
  then:  servotap record arm    servotap test arm --short    servotap stop arm

The profile is looked for in the folder, in those above it, then in the user's configuration folder (docs/profiles.md).
"""
_HEAD = """\
# Names of buses and drives: servotap record NAME, servotap test NAME, servotap stop NAME, servotap send NAME read_speed.
# Further keys of a bus: groups = [80], ids = "1,2,0x123-0x12F". Of a drive: model, subdivision, max-speed (rpm), max-turns,
# max-acceleration, max-current (mA), settings = { current = "1600 mA" }. See docs/profiles.md.
"""


class _Seen(NamedTuple):
    """What answered on one bus."""

    endpoint: Endpoint
    #: The user gave the name.
    named: bool
    found: Sequence[Found]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("endpoints", nargs="*", metavar="[NAME=]ENDPOINT", help="where to look for drives")
    parser.add_argument("-o", "--output", default=profile.FILE, metavar="FILE", help=f"default {profile.FILE}, in this folder")
    parser.add_argument("--force", action="store_true", help="replace a profile that exists")
    add_looking_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Look for drives, and write what was found; return 0, or 1 where none was."""
    if not arguments.endpoints:
        raise UsageError("where? expected an endpoint, as in arm=serial:/dev/ttyUSB0 (servotap ports lists what there is)")
    target = free_target(Path(arguments.output), arguments.force)
    if not target.resolve().parent.is_dir():
        raise UsageError(f"{target.parent} is no folder")
    seen = []
    for text, endpoint in zip(arguments.endpoints, endpoints.parse_all(arguments.endpoints), strict=True):
        named = text.startswith(f"{endpoint.name}=")
        if named and not profile.is_name(endpoint.name):
            raise UsageError(f"{endpoint.name} cannot be a name of a profile: it means something else")
        print(f"{endpoint.text}:", flush=True)
        report = look(endpoint, arguments)
        show(report, endpoint)
        seen.append(_Seen(endpoint, named, report.found))
        if report.interrupted:
            break
    ended = ended_status() if report.interrupted else 0
    if not any(each.found for each in seen):
        print("nothing written: no drive answered", file=sys.stderr)
        return ended or 1
    text, names, drive = _profile(seen)
    write_whole(target, text.encode(), replace=arguments.force)
    print(f"wrote {target}: {', '.join(names)}")
    print(f"to go on:\n  servotap record {names[0]} --view -o week.mcap\n  servotap test {drive} --short")
    return ended


def _profile(seen: Sequence[_Seen]) -> tuple[str, list[str], str]:
    """Return the text of a profile, the names in it, and the first one of a drive."""
    names: list[str] = []
    drives: list[str] = []
    lines = [_HEAD]
    for each in seen:
        if len(each.found) == 1:
            (found,) = each.found
            name = _new(each.endpoint.name if each.named else f"drive{found.address}", names)
            drives.append(name)
            lines += [f"[drive.{name}]", *_place(each.endpoint, found.speed), *_drive(found), ""]
            continue
        buses: dict[int, str] = {}
        for found in each.found:
            if found.speed not in buses:
                own = each.endpoint.name
                bus = buses[found.speed] = _new(own if profile.is_name(own) else "bus", names)
                lines += [f"[bus.{bus}]", *_place(each.endpoint, found.speed), ""]
            stem = f"{each.endpoint.name}_" if each.named else "drive"
            name = _new(f"{stem}{found.address}", names)
            drives.append(name)
            lines += [f"[drive.{name}]", f"bus = {json.dumps(buses[found.speed])}", *_drive(found), ""]
    return "\n".join(lines), names, drives[0]


def _new(wanted: str, names: list[str]) -> str:
    """Return a name that is not taken, and take it."""
    name, number = wanted, 2
    while name in names:
        name, number = f"{wanted}_{number}", number + 1
    names.append(name)
    return name


def _place(endpoint: Endpoint, speed: int) -> Iterator[str]:
    yield f"port = {json.dumps(without_rate(endpoint))}"
    if endpoint.kind != "tcp" or endpoint.speed:
        yield f"{'bitrate' if endpoint.kind == 'can' else 'baud'} = {speed}"


def _drive(found: Found) -> Iterator[str]:
    yield f"dialect = {json.dumps(found.dialect.name)}"
    yield f"address = {found.address:#x}" if found.dialect.bus == "can" else f"address = {found.address}"
    hardware = str(found.values.get("hardware_name", "")).upper()
    model = next((model for model in found.dialect.models if model in hardware), "")
    if model:
        yield f"model = {json.dumps(model)}"
    if found.identity:
        yield f"# it says: {found.identity}"
