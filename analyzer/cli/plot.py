"""Plot fields over time: as a picture (PNG, SVG, PDF), or without -o in the terminal.

A name is a quantity of the drives (position, speed, current, voltage, temperature), a field of any command, command.field,
or latency. Each name has a plot of its own, with a line for each drive. A log is not decoded again.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from analyzer.cli.as_log import AsLog, as_log
from analyzer.cli.filter import Filter, vocabulary
from analyzer.cli.output import free_target, inputs, write_whole
from analyzer.cli.reading import add_reading_arguments, tell_notes
from analyzer.dialects import every
from analyzer.errors import UsageError
from analyzer.report.kept import extremes
from analyzer.report.picture import Panel, draw, size
from analyzer.report.series import Series, series
from analyzer.sources.times import ShownTime, is_dated, is_estimated
from analyzer.table.extras import needed
from analyzer.values import SECOND_NS, printable, quote

EXAMPLES = """\
examples:
  servotap plot week.mcap speed position -o moves.png
  servotap plot capture.log                                 says which fields there are
  servotap plot capture.log speed                           in the terminal
  servotap plot week.mcap read_speed.speed --drive left/1 --since +10s --until +20s
  servotap plot week.mcap latency --filter 'command == "read_speed"' -o latency.svg
"""

_ENDINGS = (".png", ".svg", ".pdf")
#: Rows of a chart in the terminal, its least width, and the width where there is no terminal.
_ROWS, _LEAST, _USUAL = 10, 40, 100
#: Points of a line: more than a picture has dots.
_POINTS = 20_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a capture, a log, or a folder of its parts; - reads standard input")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="speed, position, read_speed.speed, latency ...; none: say which there are"
    )
    parser.add_argument("-o", "--output", metavar="OUT", help=f"the picture: a name that ends in {', '.join(_ENDINGS)}")
    parser.add_argument("--force", action="store_true", help="replace a picture that exists")
    parser.add_argument(
        "--drive", action="append", default=[], metavar="ADDRESS", help="only this drive: 1, 0x001, left/1; may be repeated"
    )
    parser.add_argument("--filter", metavar="EXPRESSION", help="only values of messages that match, as for servotap show")
    add_reading_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Plot; return 0."""
    target = None if arguments.output is None else _target(arguments)
    drive = _drives(arguments.drive)
    wanted = Filter(arguments.filter, vocabulary(every())) if arguments.filter else None
    with as_log(arguments.file, arguments) as log:
        found, time_source = series(
            log.source, arguments.names, since_ns=log.since_ns, until_ns=log.until_ns, drive=drive, wanted=wanted
        )
        notes = [*log.notes, *log.source.notes]
    plots = _Plots(log, found, timed=not is_estimated(time_source))
    if target is None:
        plots.show(shutil.get_terminal_size().columns if sys.stdout.isatty() else _USUAL)
    else:
        write_whole(target, plots.picture(target.suffix[1:].lower()), replace=arguments.force)
        print(printable(f"wrote {target}"))
    tell_notes(notes)
    return 0


def _target(arguments: argparse.Namespace) -> Path:
    """Return the picture to write, once it is known that it can be drawn. Raises UsageError where it cannot."""
    read = inputs((arguments.file, *arguments.dbc, *arguments.modbus_map))
    target = free_target(Path(arguments.output), arguments.force, read)
    if target.suffix.lower() not in _ENDINGS:
        raise UsageError(f"-o {arguments.output}: expected a name that ends in {', '.join(_ENDINGS)}")
    needed("matplotlib")
    return target


def _drives(given: Sequence[str]) -> Callable[[str, str], bool]:
    """Return a predicate: is a drive, by bus and address, among those given? Raises UsageError for a wrong address."""
    chosen: set[tuple[str, str]] = set()
    for text in given:
        bus, _, number = text.rpartition("/")
        try:
            chosen.add((bus, str(int(number, 0))))
        except ValueError:
            raise UsageError(f"--drive: got {quote(text)}, expected an address, as 1, 0x001 or left/1") from None
    return lambda bus, address: not chosen or bool({("", address), (bus, address)} & chosen)


class _Plots:
    """Series of each name, over seconds from the start; over the numbers of frames where a capture has no times."""

    def __init__(self, log: AsLog, found: Mapping[str, list[Series]], *, timed: bool) -> None:
        self._found = found
        self._timed = timed
        self._shown = log.shown if timed else ShownTime()
        self._first_ns = min(each.t_ns[0] for some in found.values() for each in some)
        self._name = log.name

    def picture(self, form: str) -> bytes:
        """Return the picture in a format."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=size(len(self._found)), layout="constrained")
        panels = [
            Panel(name, [each.unit for each in some], [(each.label, *self._thinned(each)) for each in some])
            for name, some in self._found.items()
        ]
        begin = self._first_ns
        since = f" from {self._shown.iso(begin)}" if is_dated(begin) else ""
        draw(figure, panels, self._name, f"time [s]{since}" if self._timed else "frame (the capture has no times)")
        out = io.BytesIO()
        with warnings.catch_warnings():
            # A letter that no font has is drawn as a box.
            warnings.filterwarnings("ignore", "Glyph .* missing")
            figure.savefig(out, format=form, dpi=120)
        return out.getvalue()

    def _thinned(self, each: Series) -> tuple[Sequence[float], list[float]]:
        kept = self._kept(each)
        at: Sequence[float]
        at = [(each.t_ns[n] - self._first_ns) / SECOND_NS for n in kept] if self._timed else [each.sequence[n] for n in kept]
        return at, [each.values[n] for n in kept]

    def _kept(self, each: Series) -> list[int]:
        import numpy as np

        places: list[int] = extremes(np.array(each.values, np.float64), _POINTS).tolist()
        return places

    def show(self, width: int) -> None:
        """Print charts, a chart for each line."""
        from analyzer.view.scale import SCALE_WIDTH, number_text, scaled, time_axis

        inner = max(_LEAST, width) - SCALE_WIDTH - 2
        every = [(name, each) for name, some in self._found.items() for each in some]
        places = [each.t_ns if self._timed else [n * SECOND_NS for n in each.sequence] for _, each in every]
        span = min(at[0] for at in places), max(at[-1] for at in places)
        for (name, each), at in zip(every, places, strict=True):
            ends = f"{number_text(min(each.values))} to {number_text(max(each.values))} {each.unit}".rstrip()
            print(f"{each.unit[:SCALE_WIDTH]:>{SCALE_WIDTH}} {printable(f'{name}  {each.label}')}  {ends}")
            for scale, row in scaled([(at[n], each.values[n]) for n in self._kept(each)], span, inner, _ROWS):
                print((scale + row).rstrip())
        seconds = (span[1] - span[0]) / SECOND_NS
        zone, length = (self._shown.zone or "s", f"{seconds:.4g} s") if self._timed else ("frame", f"{seconds:.0f}")
        print("\n".join(line.rstrip() for line in time_axis(span, inner, self._shown, zone, length).splitlines()))
