"""Restore the settings that a run changed, from its journal: after kill -9, a crash, a pulled plug.

Before that it looks at the shaft of each drive, and stops one that is not seen standing: settings of a turning motor are not
changed. Exit status: 0 all is put back, 1 not all could be (the journal keeps what is left), 2 wrong use, 20 not stopped.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from analyzer.catalogue import Dialect
from analyzer.dialects import drive_name
from analyzer.errors import UnreadableError, UsageError
from analyzer.live import profile
from conformance.bus.line import LineLost
from conformance.cli.endpoint import gate_to
from conformance.gate.gate import Gate
from conformance.gate.permissions import Allowance
from conformance.safety import journal
from conformance.safety.keeper import command_of, dialect_of, restore
from conformance.safety.stopping import standing_failure, stop_or_cut

EXAMPLES = """\
examples:
  servotap restore servotap-mks-can-1-20261121-101500.journal                    on the port that the journal names
  servotap restore run.journal --on serial:/dev/ttyUSB1,baud=38400
  servotap restore run.journal --dry-run
"""
NOT_ALL = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("journal", metavar="JOURNAL", help="the file that the run left")
    parser.add_argument("--on", metavar="ENDPOINT", help="where the drive is now; by default as in the journal")
    parser.add_argument("--cut-power", default="", metavar="COMMAND", help="runs when no stop can be verified")
    parser.add_argument("--dry-run", action="store_true", help="list the settings to restore, and send nothing")


def run(arguments: argparse.Namespace) -> int:
    """Put back; return 0, or 1 if not all could be."""
    path = Path(arguments.journal)
    entries = journal.read(path)
    if len(places := journal.places(entries)) > 1:
        # A drive of one port may have the name of a drive of another one.
        raise UnreadableError(f"{path}: expected the lines of one port, got {', '.join(places)}: give each a file of its own")
    changes = journal.open_changes(entries)
    if not changes:
        print(f"{path}: nothing is left to be put back")
        return 0
    try:
        commands = [command_of(change) for change in changes]
    except UsageError as error:
        raise UnreadableError(f"{path}: not a line of a run: {error}") from None
    for change, command in zip(changes, commands, strict=True):
        print(f"{change.target}: {command.name} {journal.values_text(command, change.values)}")
    if arguments.dry_run:
        return 0
    place = arguments.on or changes[0].on
    if not place:
        raise UnreadableError(f"{path} does not say where the drive was: give --on ENDPOINT")
    endpoint = profile.endpoint(place)
    dialects = {change.address: dialect_of(change) for change in changes}
    for dialect in dialects.values():
        endpoint.check_dialect(dialect)
    addresses = frozenset(dialects)
    found: list[str] = []
    # Reads by this gate; what is put back, and nothing else, passes another one.
    with gate_to(endpoint, Allowance(addresses=addresses)) as gate:
        try:
            # A drive that may answer elsewhere is brought back first, for it has to be stopped there.
            restore(path, gate, link_only=True)
            for address, dialect in dialects.items():
                found.append(_stand(gate, dialect, address, arguments.cut_power))
            failure = restore(path, gate)
        except LineLost as error:
            failure = str(error)
    # After all drives: one that turns is stopped, and settings are put back, also where nothing can be printed.
    for told in found:
        print(told)
    if failure:
        left = len(journal.open_changes(journal.read(path)))
        print(f"servotap restore: {left} of {len(changes)} not put back: {failure}", file=sys.stderr)
        return NOT_ALL
    print(f"all {len(changes)} put back")
    return 0


def _stand(gate: Gate, dialect: Dialect, address: int, power: str) -> str:
    """Look at the shaft, stop it where it does not stand, and return what was found. Raises NotStopped."""
    name = drive_name(dialect, address)
    failure = standing_failure(gate, dialect, address)
    if not failure:
        return f"{name}: the shaft stands"
    stop_or_cut(gate, dialect, address, power)
    return f"{name}: the shaft was not seen standing ({failure}): stopped, and it stands"
