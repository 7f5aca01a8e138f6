"""Print the bytes of a frame: a command of a dialect, to an address, with values by name.

Values are physical, in the unit of their field (320, 3.5, 0x10), or names of choices (direction=cw, work_mode=sr_vfoc);
switches take on and off. Fields left out take their default or 0. On CAN the identifier stands first. Nothing is sent.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Role
from analyzer.cli.option_types import add_model_argument
from analyzer.dialects import code_text, find_command
from analyzer.encoder import SLOTS, Built, assemble
from analyzer.errors import UsageError
from analyzer.live.profile import drive as profile_drive
from analyzer.reference.hex_frame import write_frame
from analyzer.values import quote

EXAMPLES = """\
exit status: 0 printed; 2 wrong use, or a value that the manual does not allow (see --force).

examples:
  servotap frame mks-rs485@1 run_speed direction=ccw speed=320 acceleration=2
  servotap frame mks-can@1 run_speed direction=ccw speed=320 acceleration=2 --candump
  servotap frame mks-modbus@1 set_work_mode work_mode=sr_vfoc
  servotap frame lk-rs485@1 move_multi_turn position=360.5
  servotap frame mks-rs485@1 run_speed status=1 --reply
  servotap frame mks-rs485@all long_package slot="1 run_speed direction=cw speed=50 acceleration=2"

A field without a default in the manual must be given; what is left out takes its default, and that is shown.
'servotap catalogue NAME' lists the fields of a command.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "target", metavar="DRIVE", help="the recipient: mks-rs485@1, mks-can@0x123, mks-rs485@all, or a name of a profile"
    )
    parser.add_argument("command", metavar="COMMAND", help="its name, or a code that only one command has")
    parser.add_argument("values", nargs="*", metavar="FIELD=VALUE", help='values of its fields; slot="1 run_speed speed=50"')
    parser.add_argument("--reply", action="store_true", help="the drive's reply instead of the request")
    parser.add_argument("--form", metavar="NAME", help="the form, if the fields do not determine it")
    add_model_argument(parser)
    parser.add_argument("--wire", action="store_true", help="numbers are integers as sent")
    parser.add_argument("--force", action="store_true", help="build values that the manual forbids, if the bits hold them")
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--candump", action="store_true", help="as 001#F60140023A (CAN)")
    shown.add_argument("--json", action="store_true", help="a JSON object with the frame and its risks")


def run(arguments: argparse.Namespace) -> int:
    """Print the frame; return 0."""
    dialect, address = parse_target(arguments.target, arguments.model)
    if arguments.candump and dialect.link.kind != "can":
        raise UsageError(f"--candump is for CAN, got {dialect.name}")
    command = find_command(dialect, arguments.command)
    role = Role.REPLY if arguments.reply else Role.REQUEST
    values = parse_values(arguments.values)
    built = assemble(dialect, command, address, values, role, arguments.form, physical=not arguments.wire, complete=True)
    if built.refusals and not arguments.force:
        raise UsageError("; ".join(built.refusals))
    if built.filled and not arguments.json:
        print(filled_text(built), file=sys.stderr)
    text = write_frame(built.frame, built.can_id, candump=arguments.candump)
    print(json.dumps(_object(dialect, built, text)) if arguments.json else text)
    return 0


def _object(dialect: Dialect, built: Built, text: str) -> dict[str, Any]:
    command = built.command
    return {
        "dialect": dialect.name,
        "address": built.address,
        "command": command.name,
        "code": code_text(command.code, command.function),
        "role": built.role.value,
        "frame": text,
        "risk": sorted(built.risks),
        "section": command.section,
        "filled": dict(built.filled),
    }


def filled_text(built: Built) -> str:
    """Say what was left out: fields took the manual's default, those of a stop without one 0."""
    return "left out and taken so: " + ", ".join(f"{name}={value}" for name, value in built.filled.items())


def parse_target(text: str, model: str | None) -> tuple[Dialect, int]:
    """Return dialect and address of `DIALECT@ADDRESS`, or of a drive of a profile, as a model speaks it.

    Raises UsageError for anything else.
    """
    named = profile_drive(text)
    if named is not None:
        return registry.for_model([named.dialect], model or named.entry.model or None)[0], named.entry.address
    name, separator, where = text.partition("@")
    dialect = registry.get(name)
    if not separator or not where:
        raise UsageError(f"expected DIALECT@ADDRESS as {dialect.name}@1, got {quote(text)}")
    dialect = registry.for_model([dialect], model)[0]
    if where.lower() == "all":
        if dialect.broadcast is None:
            raise UsageError(f"{dialect.name} has no broadcast address")
        return dialect, dialect.broadcast
    return dialect, _address(where)


def _address(text: str) -> int:
    try:
        return int(text, 0) if len(text) <= 16 else int("")
    except ValueError:
        raise UsageError(f"address: got {quote(text)}, expected a number as 1 or 0x10, or all") from None


def parse_values(words: Sequence[str]) -> Mapping[str, Any]:
    """Return the values of `FIELD=VALUE` words by field name, as texts; the slots of a package as a list.

    Raises UsageError for a word that is none.
    """
    values: dict[str, Any] = {}
    for word in words:
        name, separator, value = word.partition("=")
        name = name.strip().lower().replace("-", "_")
        if not separator or not name:
            raise UsageError(f"expected FIELD=VALUE, got {quote(word)}")
        if name in ("slot", SLOTS):
            values.setdefault(SLOTS, []).append(_slot(value, len(values.get(SLOTS, ())) + 1))
        elif name in values:
            raise UsageError(f"{quote(name)} is given twice")
        else:
            values[name] = value
    return values


def _slot(text: str, number: int) -> Mapping[str, Any]:
    """Return a slot from `1 run_speed speed=50`."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise UsageError(f"slot {number}: {error} in {quote(text)}") from None
    if len(words) < 2:
        raise UsageError(f'slot {number}: expected "ADDRESS COMMAND FIELD=VALUE ...", got {quote(text)}')
    fields = parse_values(words[2:])
    if SLOTS in fields:
        raise UsageError(f"slot {number}: a slot cannot hold slots")
    return {**fields, "address": _address(words[0]), "command": words[1]}
