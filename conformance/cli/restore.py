"""Put back what a run changed and did not put back, from its journal: after kill -9, a crash, a pulled plug."""

from __future__ import annotations

import argparse
from pathlib import Path

from analyzer import endpoint as endpoints
from analyzer.catalogue import Risk
from analyzer.errors import UnreadableError, UsageError
from conformance.gate import Allowance, Gate
from conformance.lines import open_line
from conformance.safety import journal
from conformance.safety.restoring import restore

EXAMPLES = """\
examples:
  servotap restore servotap-mks-can-1-20261121-101500.journal                    on the port that the journal names
  servotap restore run.journal --on serial:/dev/ttyUSB1,baud=38400
  servotap restore run.journal --dry-run
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("journal", metavar="JOURNAL", help="the file that the run left")
    parser.add_argument("--on", metavar="ENDPOINT", help="where the drive is now; by default where it was")
    parser.add_argument("--dry-run", action="store_true", help="say what would be put back, and send nothing")


def run(arguments: argparse.Namespace) -> int:
    """Put back; return 0, or 1 if not all could be."""
    path = Path(arguments.journal)
    changes = journal.open_changes(journal.read(path))
    if not changes:
        print(f"{path}: nothing is left to be put back")
        return 0
    for change in changes:
        print(f"{change.target}: {change.command} {journal.values_text(change.values)}")
    if arguments.dry_run:
        return 0
    place = arguments.on or changes[0].on
    if not place:
        raise UnreadableError(f"{path} does not say where the drive was: give --on ENDPOINT")
    addresses = frozenset(change.address for change in changes)
    # What is put back is what was there: every risk of a setting is allowed, for these drives alone.
    risks = frozenset({Risk.READ, Risk.SETTING, Risk.TORQUE, Risk.LINK, Risk.POWER_ON, Risk.WEAR})
    line = open_line(endpoints.parse(place))
    try:
        allowance = Allowance(risks, addresses=addresses, alone=any(_links(c) for c in changes))
        told = restore(path, Gate(line, allowance))
    finally:
        line.close()
    if told:
        raise UsageError(f"not put back: {told}")
    print(f"all {len(changes)} put back")
    return 0


def _links(change: journal.Entry) -> bool:
    return change.command in ("set_address", "set_baud_rate", "set_bit_rate", "set_modbus", "set_group_address")
