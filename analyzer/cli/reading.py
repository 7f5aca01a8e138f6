"""What the commands that read captures share: their options, opening, the choice of dialects, progress."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from analyzer import dialects as registry
from analyzer.detect import Choice, choose
from analyzer.errors import UnreadableError, UsageError
from analyzer.framer import SILENCE_NS
from analyzer.pipeline import Options
from analyzer.records import CanFrame, Chunk, Comment

if TYPE_CHECKING:
    from analyzer.sources import Source

#: How much of a capture the choice of dialects looks at; of standard input less, so that a live pipe shows at once.
SAMPLE_BYTES = 256 * 1024
SAMPLE_ITEMS = 20_000
PIPE_SAMPLE_BYTES = 256
BITS_PER_BYTE = 10

Item = Chunk | CanFrame | Comment


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command that reads captures."""
    parser.add_argument("--dialect", default="auto", metavar="D", help="auto (default), or one of: see catalogue; D,D")
    parser.add_argument("--model", metavar="M", help="42D 57D 28D 35D 42E 57E MF MG MH MS: limits and units of a model")
    parser.add_argument("--baud", type=_positive, metavar="N", help="line speed, for times and the bus load")
    parser.add_argument("--format", metavar="F", help="capture format, where it is not to be found by content")
    parser.add_argument(
        "--group", action="append", type=_address, default=[], metavar="ADDRESS",
        help="an address that several drives listen to and none answers; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--late", type=_milliseconds, default=1000.0, metavar="MS", help="replies later than this are late (default 1000)"
    )


def _positive(text: str) -> int:
    value = int(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text}")
    return value


def _address(text: str) -> int:
    value = int(text, 0)
    if not 0 <= value <= 0x7FF:
        raise argparse.ArgumentTypeError(f"expected an address 0..0x7FF, got {text}")
    return value


def _milliseconds(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"expected milliseconds above 0, got {text}")
    return value


class Reading:
    """A capture that is open, with its dialects chosen. Iterate it once for its items."""

    def __init__(self, source: Source, arguments: argparse.Namespace) -> None:
        self.source = source
        self._iterator = iter(source)
        sample = self._sample(PIPE_SAMPLE_BYTES if source.path == "-" else SAMPLE_BYTES, arguments)
        self._items = chain(sample, self._iterator)
        traffic = [item for item in sample if not isinstance(item, Comment)]
        self.has_times = any(item.t_ns is not None for item in traffic)
        self.choice = self._choose(sample, arguments)
        chosen = registry.for_model(self.choice.dialects, arguments.model)
        self.dialects = tuple(chosen)
        self.options = self._options(arguments)

    def __iter__(self) -> Iterator[Item]:
        """Yield all items of the capture."""
        return self._items

    def _sample(self, most_bytes: int, arguments: argparse.Namespace) -> list[Item]:
        sample: list[Item] = []
        size = 0
        for item in self._iterator:
            sample.append(item)
            size += 0 if isinstance(item, Comment) else len(item.data)
            decided = arguments.dialect != "auto" or isinstance(item, CanFrame)
            if (decided and size) or size >= most_bytes or len(sample) >= SAMPLE_ITEMS:
                break
        return sample

    def _choose(self, sample: list[Item], arguments: argparse.Namespace) -> Choice:
        if arguments.dialect != "auto":
            chosen = tuple(registry.get(name.strip()) for name in arguments.dialect.split(","))
            kind = next((("can" if isinstance(i, CanFrame) else "serial") for i in sample if not isinstance(i, Comment)), "")
            wrong = [d for d in chosen if kind and d.bus != kind]
            if wrong:
                raise UsageError(f"{self.source.name} is of a {kind} bus, and {wrong[0].name} is a dialect of {wrong[0].bus}")
            return Choice(chosen, (), "as given")
        return choose(registry.every(), sample)

    def _options(self, arguments: argparse.Namespace) -> Options:
        first = self.dialects[0]
        speed = arguments.baud or (first.baud_rates[0] if first.baud_rates else 115200)
        made_up = BITS_PER_BYTE * 1_000_000_000 // speed
        return Options(
            byte_ns=made_up if arguments.baud or not self.has_times else 0,
            synthetic_byte_ns=made_up,
            synthetic_bit_ns=1_000_000_000 // speed,
            timed=self.has_times,
            late_ns=int(arguments.late * 1e6),
            silence_ns=SILENCE_NS,
            groups=frozenset(arguments.group),
        )

    @property
    def time_source(self) -> str:
        """Where the times come from, in words."""
        if self.has_times:
            return self.source.time_source
        unit = "bit rate" if self.dialects[0].bus == "can" else "baud rate"
        return f"made up from the {unit}: the capture has no times"


def open_reading(path: str, arguments: argparse.Namespace) -> Reading:
    """Open a capture and choose its dialects.

    Raises UnreadableError for what cannot be read, UsageError for options that do not fit it.
    """
    from analyzer.sources import open_source

    source = open_source(path, format=arguments.format, baud=arguments.baud)
    try:
        return Reading(source, arguments)
    except BaseException:
        source.close()
        raise


@contextmanager
def progress(source: Source, what: str) -> Iterator[None]:
    """Show progress on the terminal while something longer than a second runs; quiet elsewhere."""
    if not sys.stderr.isatty() or source.size is None:
        yield
        return
    import threading

    done = threading.Event()

    def show() -> None:
        if done.wait(1.0):
            return
        from rich.console import Console
        from rich.markup import escape
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(escape(what), total=source.size)
            while not done.wait(0.2):
                bar.update(task, completed=source.position())

    watcher = threading.Thread(target=show, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()


def clean(text: str) -> str:
    """Return a text with control characters made visible, so that nothing in a capture steers the terminal."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


def require_file(path: str) -> Path:
    """Return the path of an existing file.

    Raises UnreadableError with the reason if it is none.
    """
    found = Path(path)
    if found.is_dir():
        raise UnreadableError(f"{path} is a folder, expected a capture file")
    if not found.exists():
        raise UnreadableError(f"{path} does not exist")
    return found


def now_text() -> str:
    """Return the time of day in UTC for a log's metadata."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
