"""Print a DBC file of a CAN dialect: its commands for other tools (cantools, SavvyCAN, CANdb++, Kvaser, Vector, PEAK).

A DBC file has one sender for each identifier, and here requests and replies share it: a file has the replies, or with
--role request the requests. What DBC cannot express is left out and listed on standard error.
"""

from __future__ import annotations

import argparse
import sys

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.cli.option_types import address
from analyzer.cli.output import add_text_output, deliver
from analyzer.errors import UsageError
from analyzer.reference.dbc import dbc, shapes

EXAMPLES = """\
examples:
  servotap dbc mks-can > mks.dbc
  servotap dbc mks-can --address 1 --address 2 -o drives.dbc
  servotap dbc mks-can --role request -o requests.dbc
  cantools decode mks.dbc < capture.log                     candump lines
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("dialect", metavar="DIALECT", help="a dialect on CAN: mks-can, or one of a package")
    parser.add_argument("--address", type=address, action="append", metavar="N", help="a drive, 1 by default; several times")
    parser.add_argument("--role", choices=("reply", "request"), default="reply", help="whose frames; reply by default")
    parser.add_argument("--model", metavar="M", help="limits and units of a model: 42E 57E")
    add_text_output(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the file, and what it leaves out; return 0."""
    dialect = registry.for_model([registry.get(arguments.dialect)], arguments.model)[0]
    if dialect.bus != "can":
        raise UsageError(f"{dialect.name} is on {dialect.bus}, and DBC is for CAN: mks-can is")
    first, last = dialect.addresses
    chosen = list(dict.fromkeys(arguments.address or [max(first, 1)]))
    for each in chosen:
        if not first <= each <= last:
            raise UsageError(f"--address: {dialect.name} has {first} to {last}, got {each}")
    role = Role(arguments.role)
    deliver(dbc(dialect, chosen, role), arguments)
    print("left out, for DBC cannot express it:", file=sys.stderr)
    if dialect.link.checked:
        print("  checksums: their place depends on the length of the frame", file=sys.stderr)
    for line in dict.fromkeys(map(str, shapes(dialect, chosen[0], role)[1])):
        print(f"  {line}", file=sys.stderr)
    return 0
