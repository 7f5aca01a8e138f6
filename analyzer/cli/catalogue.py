"""Print the catalogue: an overview of the dialects, the reference page of a command, errata or statements of the manuals.

A command is named by its name (run_speed), its code (0xF6, F6) or its register (0x0030, 04:0030); without --dialect it is
looked up in every dialect.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence

import msgspec

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect
from analyzer.cli.option_types import add_model_argument
from analyzer.dialects import search_commands
from analyzer.reference.objects import concerns, reference
from analyzer.reference.pages import errata, listing, overview, page, statements

EXAMPLES = """\
--json prints one object. In it every number of a field (minimum, maximum, default, fixed, values, the keys of choices) is
the integer as sent: times `scale` it is a value in `unit`. bit_offset counts bits from the first byte of the command's
own data, the most significant first. Keys that do not apply are left out.

examples:
  servotap catalogue
  servotap catalogue run_speed
  servotap catalogue speed                       commands with this word in their name or summary
  servotap catalogue 6.5.1                       commands of a section of the manual
  servotap catalogue --dialect mks-modbus 04:0030
  servotap catalogue --dialect lk-rs485 --model MF run_torque
  servotap catalogue --errata --dialect mks-can
  servotap catalogue --statements --dialect lk-rs485
  servotap catalogue --json > catalogue.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "command", nargs="?", metavar="NAME|CODE", help="this command's page; or a word, a section: what has it"
    )
    parser.add_argument("--dialect", metavar="D", help="only this dialect")
    add_model_argument(parser)
    parser.add_argument("--errata", action="store_true", help="the errata of the manuals, or of one command")
    parser.add_argument("--statements", action="store_true", help="what the manuals say a drive does, and the claims about it")
    parser.add_argument("--pages", action="store_true", help="the pages of all commands")
    parser.add_argument("--json", action="store_true", help="one JSON object; numbers are integers as sent")


def run(arguments: argparse.Namespace) -> int:
    """Print what is asked for; return 0."""
    dialects = registry.asked_for(arguments.dialect, arguments.model)
    chosen: dict[str, list[Command]] | None = None
    several = False
    if arguments.command is not None:
        found, several = search_commands(dialects, arguments.command)
        chosen = {}
        for dialect, command in found:
            chosen.setdefault(dialect.name, []).append(command)
        dialects = [d for d in dialects if d.name in chosen]
    if arguments.statements and arguments.json:
        rows = [{"dialect": d.name, "section": s.section} | msgspec.to_builtins(s) for d in dialects for s in d.statements]
        print(json.dumps(rows, indent=1))
        return 0
    if arguments.json:
        print(json.dumps(reference(dialects, chosen, errata_only=arguments.errata), indent=1))
        return 0
    if several and chosen is not None and not (arguments.errata or arguments.statements or arguments.pages):
        for dialect in dialects:
            print(dialect.name)
            for line in listing(chosen[dialect.name]):
                print(line)
        return 0
    for index, lines in enumerate(_texts(dialects, chosen, arguments)):
        if index:
            print()
        for line in lines:
            print(line)
    return 0


def _texts(
    dialects: Sequence[Dialect], chosen: dict[str, list[Command]] | None, arguments: argparse.Namespace
) -> Iterator[Iterator[str]]:
    for dialect in dialects:
        commands = dialect.commands if chosen is None else chosen[dialect.name]
        if arguments.statements:
            yield statements(dialect)
        elif arguments.errata:
            about = [e for e in dialect.errata if chosen is None or any(concerns(e, c) for c in commands)]
            yield errata(dialect, about)
        elif chosen is None and not arguments.pages:
            yield overview(dialect)
        else:
            for command in commands:
                yield page(dialect, command)
