"""View a capture or a log in the terminal: frames, counts, findings, a plot, each frame byte by byte.

The file is read once, from its beginning, while it is shown already; ? shows the keys. Frames are kept compressed, beyond
64 MB of them in a temporary file, and decoded again when they are looked at. A recording is watched with
'servotap record --view', or with --follow from elsewhere.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from analyzer.cli.filter import Filter, vocabulary
from analyzer.cli.reading import add_reading_arguments, open_reading, tell_notes
from analyzer.errors import UsageError
from analyzer.live.lock import recorded
from analyzer.live.profile import FILE, names
from analyzer.sources.tail import Follow
from analyzer.view import require_terminal, run_capture

EXAMPLES = """\
examples:
  servotap view capture.log
  servotap view capture.log.mcap --filter '"bad_checksum" in findings'
  servotap view week.mcap --since +10min --until +20min
  servotap view --follow week.mcap                 while it is recorded, from another terminal
  servotap view wire.bin --dialect mks-rs485 --baud 38400
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a capture, an MCAP log, or a folder of its parts")
    parser.add_argument("--follow", action="store_true", help="follow a log that is being recorded")
    parser.add_argument("--filter", default="", metavar="EXPRESSION", help="start with the frames that match this expression")
    add_reading_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """View the capture; return 0."""
    if arguments.file == "-":
        raise UsageError("the view reads the keyboard from standard input: save the capture to a file, or use servotap show -")
    if arguments.file in names() and not Path(arguments.file).exists():
        raise UsageError(f"{arguments.file} is a name of {FILE}, expected a file (servotap record {arguments.file} --view)")
    require_terminal()
    reading = open_reading(arguments.file, arguments, Follow(recorded) if arguments.follow else None)
    with contextlib.closing(reading.source):
        if arguments.filter:
            Filter(arguments.filter, vocabulary(reading.possible))
        why = run_capture(reading, filter_text=arguments.filter)
        tell_notes(reading.source.notes)
    if why != "quit":
        raise UsageError(why)
    return 0
