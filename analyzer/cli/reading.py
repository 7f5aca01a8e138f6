"""What the commands that read captures share: their options, opening, the choice of dialects, progress."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import msgspec

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.cli.option_types import (
    add_device_arguments,
    add_group_argument,
    add_ids_argument,
    add_model_argument,
    ids_of,
    milliseconds,
    positive,
)
from analyzer.cli.time_range import TimeRange, add_time_range_arguments
from analyzer.detect import Choice, choose
from analyzer.devices import load
from analyzer.entries import Sink
from analyzer.errors import UsageError
from analyzer.events import SETUPS
from analyzer.framer import SILENCE_NS
from analyzer.pipeline import Item, Pipeline
from analyzer.port import Options, PortSetup, Setups, listed_in
from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources.times import ESTIMATED
from analyzer.values import printable, quote

if TYPE_CHECKING:
    from analyzer.sources import Source
    from analyzer.sources.tail import Follow

__all__ = ["Item", "OpenCapture", "add_reading_arguments", "now_text", "open_reading", "progress", "source_options"]

#: From this size on, in bytes, a capture is read in blocks, and a process of its own is worth starting.
LONG_CAPTURE = 1 << 20
#: How much of a capture the choice of dialects looks at; of standard input less, so that a live pipe shows at once.
SAMPLE_BYTES = 256 * 1024
SAMPLE_ITEMS = 20_000
PIPE_SAMPLE_BYTES = 256
BITS_PER_BYTE = 10
_RECORDED = "as recorded"
#: Formats of a UART: data bits, parity (none, even, odd), stop bits.
UART_FORMATS = tuple(f"{bits}{parity}{stops}" for bits in (8, 7) for parity in "NEO" for stops in (1, 2))
#: Milliseconds after which a reply is late, where neither the user nor the recording says otherwise.
LATE_MS = 1000.0


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command that reads captures."""
    parser.add_argument("--dialect", default="auto", metavar="D", help="auto (default), or one of: see catalogue; D,D")
    add_device_arguments(parser)
    add_model_argument(parser)
    parser.add_argument("--baud", type=positive, metavar="N", help="line speed: for timestamps, bus load, logic analyzers")
    parser.add_argument(
        "--channel", action="append", default=[], metavar="NAME",
        help="the channel of a logic analyzer that is read (default: found); may be repeated",
    )  # fmt: skip
    parser.add_argument("--inverted", action="store_true", help="the channels are low when idle (default: found)")
    parser.add_argument(
        "--uart", choices=UART_FORMATS, default="", metavar="8E1",
        help="data bits, parity and stop bits on the channels (default: found)",
    )  # fmt: skip
    parser.add_argument("--format", metavar="F", help="capture format, if detection by content fails")
    add_group_argument(parser)
    add_ids_argument(parser)
    parser.add_argument("--late", type=milliseconds, metavar="MS", help="report replies later than this (default 1000)")
    add_time_range_arguments(parser)


def asks_for_decoding(arguments: argparse.Namespace) -> bool:
    """Say whether an option of `add_reading_arguments` asks for another decoding than the one in a log."""
    names = ("dbc", "modbus_map", "model", "baud", "group", "ids", "late")
    return arguments.dialect != "auto" or any(getattr(arguments, name) for name in names)


class OpenCapture:
    """A capture that is open, with its dialects chosen. Iterate it once for its items.

    `dialects`: those that were chosen, for all buses together. What a recording says of its buses counts, unless the user
    says otherwise.
    """

    def __init__(self, source: Source, arguments: argparse.Namespace) -> None:
        self.source = source
        self._arguments = arguments
        self._ids = ids_of(arguments.ids)
        since, until = getattr(arguments, "since", None), getattr(arguments, "until", None)
        self.time_range = TimeRange(source, since, until, utc=getattr(arguments, "utc", False))
        self._iterator = self.time_range.items(source)
        #: Files that describe other devices.
        self.device_files = tuple(load(arguments.dbc, arguments.modbus_map, source.note))
        self._devices = tuple(d for file in self.device_files for d in file.dialects)
        brief = source.path == "-" or source.follow is not None
        sample = self._sample(PIPE_SAMPLE_BYTES if brief else SAMPLE_BYTES)
        self._items = chain(sample, self._iterator)
        traffic = [item for item in sample if isinstance(item, (Chunk, CanFrame))]
        self.has_times = any(item.t_ns is not None for item in traffic) or source.kind == "log"
        self._said = _Said(sample)
        self.model: str = arguments.model or self._said.model
        self._given = self._given_dialects(traffic)
        self._known: dict[str, Dialect] = {}
        self._kinds: dict[str, str] = {}
        #: Buses whose dialects were chosen apart.
        self.ports: dict[str, PortSetup] = {}
        self._reasons: dict[str, str] = {}
        if self._said.buses or len({type(item) for item in traffic}) > 1:
            self.choice = self._choose_by_bus(traffic)
            self.dialects = self.choice.dialects
        else:
            self.choice = self._choose(traffic)
            self.dialects = tuple(registry.for_model(self.choice.dialects, self.model or None))
            self.ports = {bus: PortSetup(self.dialects, listed=ids) for bus, ids in self._ids.by_bus.items()}
        self._first_kinds = {d.bus for d in self.dialects}
        if self.model:
            # A model that no dialect has is told before anything is made.
            self._by_name()
        #: Characters that an address takes: on CAN it is shown in hexadecimal.
        self.who_width = 5 if any(isinstance(item, CanFrame) for item in traffic) else 4
        self.options = self._options()

    @cached_property
    def others(self) -> tuple[Dialect, ...]:
        """Dialects of a bus of another kind, which may come up late; most often they are not even loaded."""
        every = self._known or self._by_name()
        return tuple(d for d in every.values() if d.bus not in self._first_kinds)

    def __iter__(self) -> Iterator[Item]:
        return self._items

    def pipeline(self, sinks: Sequence[Sink]) -> Pipeline:
        on_setup: Callable[[Event], PortSetup | None] | None = self._set_up if self._known else None
        wanted = self.time_range.sinks(sinks)
        return Pipeline(self.dialects, wanted, self.options, ports=self.ports, on_setup=on_setup, others=lambda: self.others)

    @property
    def possible(self) -> tuple[Dialect, ...]:
        """All dialects that may come up: a recording can say later that another has joined, or have a bus of another kind."""
        return tuple(self._known.values()) or (*self.dialects, *self.others)

    def _by_name(self) -> dict[str, Dialect]:
        return registry.readable_by_name(self._devices, self.model)

    # --- the choice of dialects -----------------------------------------------------------------------------------

    def _sample(self, most_bytes: int) -> list[Item]:
        given = self._arguments.dialect != "auto"
        sample: list[Item] = []
        size = 0
        #: Buses of which a recording says what they are in, and of which it does not.
        told: set[str] = set()
        untold: set[str] = set()
        for item in self._iterator:
            sample.append(item)
            if isinstance(item, Event) and item.name in SETUPS:
                (told.add if item.values.get("dialects") else untold.add)(item.port)
            if isinstance(item, (Chunk, CanFrame)):
                size += len(item.data)
                decided = given or isinstance(item, CanFrame) or item.port in told
                if decided and size and told >= untold:
                    break
            if size >= most_bytes or len(sample) >= SAMPLE_ITEMS:
                break
        return sample

    def _given_dialects(self, traffic: Sequence[Chunk | CanFrame]) -> tuple[Dialect, ...]:
        """Return the dialects that the user named. Raises UsageError where they cannot be those of the capture."""
        if self._arguments.dialect == "auto":
            return ()
        chosen = tuple(registry.get(name.strip()) for name in self._arguments.dialect.split(","))
        kind = next((_kind(item) for item in traffic), "")
        wrong = [d for d in chosen if kind and d.bus != kind]
        if wrong and not self._said.buses:
            raise UsageError(f"{self.source.name} is of a {kind} bus, and {wrong[0].name} is a dialect of {wrong[0].bus}")
        return chosen

    def _choose(self, traffic: Sequence[Chunk | CanFrame]) -> Choice:
        """Choose for all buses alike: what the user named, else by the traffic."""
        if self._given:
            return Choice(self._with_devices(self._given, self._given[0].bus), (), "as given")
        return choose([*registry.every(), *registry.of_no_drive()], traffic, self._devices)

    def _choose_by_bus(self, traffic: Sequence[Chunk | CanFrame]) -> Choice:
        """Choose for each bus by itself: as the user says, as the recording found it, or by its traffic."""
        known = self._known = self._by_name()
        self._kinds = kinds = self._said.kinds | {item.port: _kind(item) for item in traffic}
        for bus, kind in kinds.items():
            given = [known.get(d.name, d) for d in self._given if d.bus == kind]
            said = self._spoken(bus, self._said.buses.get(bus, ()), kind)
            if given:
                chosen, self._reasons[bus] = self._with_devices(given, kind), "as given"
            elif said:
                chosen, self._reasons[bus] = self._with_devices(said, kind), _RECORDED
            else:
                own = [item for item in traffic if item.port == bus]
                every = [d for d in known.values() if d not in self._devices]
                choice = choose(every, own, self._devices) if own else Choice(self._of_kind(kind), (), "no traffic yet")
                chosen, self._reasons[bus] = choice.dialects, choice.reason
            values = self._said.values.get(bus, {})
            self.ports[bus] = PortSetup(chosen, self._byte_ns(values), listed=self._listed(bus, values))
        return self._all_chosen()

    def _spoken(self, bus: str, names: Sequence[str], kind: str) -> list[Dialect]:
        """Return the dialects that a recording names for a bus, as far as they are known and can be spoken there."""
        spoken = [self._known[name] for name in names if name in self._known and self._known[name].bus == kind]
        if len(spoken) < len(names):
            others = ", ".join(quote(name) for name in names if name not in {d.name for d in spoken})
            self.source.note(
                f"{bus} is said to speak {others}, which is no dialect known here for a {kind} bus: left out. "
                "Its file, if it has one, is given with --dbc or --modbus-map"
            )
        return spoken

    def _all_chosen(self) -> Choice:
        """Return the choices of all buses as one."""
        used = {d.name: d for setup in self.ports.values() for d in setup.dialects}
        reason = "; ".join(
            f"{bus}: {', '.join(d.name for d in self.ports[bus].dialects)}, {why}" for bus, why in self._reasons.items()
        )
        return Choice(tuple(used.values()) or tuple(self._known.values()), (), reason or "no traffic")

    def _set_up(self, event: Event) -> PortSetup | None:
        """Return what a bus is from an event on."""
        kind = self._kinds.setdefault(event.port, event.values.get("kind") or "serial")
        names = [d.name for d in self._spoken(event.port, event.values.get("dialects") or (), kind)]
        said = Setups(self._known)(msgspec.structs.replace(event, values=event.values | {"dialects": names}))
        given = tuple(self._known.get(d.name, d) for d in self._given if d.bus == kind)
        before = self.ports.get(event.port)
        dialects = self._with_devices(given or (said.dialects if said is not None else ()), kind)
        dialects = dialects or (before.dialects if before is not None else self._of_kind(kind))
        offset = event.values.get("offset", 0)
        listed = self._listed(event.port, event.values)
        setup = PortSetup(dialects, self._byte_ns(event.values), offset if isinstance(offset, int) else 0, listed)
        if not given and said is not None:
            self._reasons[event.port] = _RECORDED
        self.ports[event.port] = setup
        self.choice = self._all_chosen()
        self.dialects = self.choice.dialects
        return setup

    def _with_devices(self, chosen: Sequence[Dialect], kind: str) -> tuple[Dialect, ...]:
        """Return dialects with those of the device files, which come first; none where none was chosen."""
        devices = [d for d in self._devices if d.bus == kind and d not in chosen]
        return (*devices, *chosen) if chosen else ()

    def _of_kind(self, kind: str) -> tuple[Dialect, ...]:
        every = [d for d in self._known.values() if d.bus == kind and (d.of_drives or d in self._devices)]
        return tuple(every)

    def _listed(self, bus: str, values: dict[str, Any]) -> frozenset[int] | None:
        """Return who is a drive on a bus: as the user says, else as the recording does."""
        given = self._ids.of(bus)
        return listed_in(values) if given is None else given

    def _byte_ns(self, values: dict[str, Any]) -> int | None:
        said = values.get("byte_ns")
        return None if self._arguments.baud or not isinstance(said, int) else said

    # --- options --------------------------------------------------------------------------------------------------

    def _options(self) -> Options:
        arguments = self._arguments
        usual = next((d.baud_rates[0] for d in self.dialects if d.baud_rates), 115200)
        speed = arguments.baud or usual
        made_up = BITS_PER_BYTE * 1_000_000_000 // speed
        late_ms = arguments.late if arguments.late is not None else self._said.late_ms
        return Options(
            byte_ns=made_up if arguments.baud or not self.has_times else 0,
            synthetic_byte_ns=made_up,
            synthetic_bit_ns=1_000_000_000 // speed,
            timed=self.has_times,
            late_ns=int(late_ms * 1e6),
            silence_ns=SILENCE_NS,
            groups=frozenset((*arguments.group, *self._said.groups)),
            listed=self._ids.everywhere,
        )

    @property
    def time_source(self) -> str:
        """Where the times come from, in words."""
        if self.has_times:
            return self.source.time_source
        unit = "bit rate" if self.dialects[0].bus == "can" else "baud rate"
        return f"{ESTIMATED} from the {unit}: the capture has none"


class _Said:
    """What a recording says of itself at its beginning: the dialects of its buses, the options it was decoded with."""

    def __init__(self, sample: Sequence[Item]) -> None:
        #: Bus -> dialects, as the first traffic of it had them; kinds of the buses; all that was said of them.
        self.buses: dict[str, list[str]] = {}
        self.kinds: dict[str, str] = {}
        self.values: dict[str, dict[str, Any]] = {}
        self.model = ""
        self.late_ms = LATE_MS
        self.groups: list[int] = []
        for item in sample:
            if not isinstance(item, Event):
                continue
            values = item.values
            if item.name in SETUPS:
                self.buses[item.port] = [str(name) for name in values.get("dialects") or ()]
                self.kinds[item.port] = values.get("kind") or "serial"
                self.values[item.port] = values
            elif item.name == "part":
                self.model = str(values.get("model", ""))
                late, groups = values.get("late"), values.get("groups")
                self.late_ms = late * 1e3 if isinstance(late, (int, float)) and late > 0 else LATE_MS
                self.groups = [g for g in groups if isinstance(g, int)] if isinstance(groups, (list, tuple)) else []


def _kind(item: Chunk | CanFrame) -> str:
    return "can" if isinstance(item, CanFrame) else "serial"


def source_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the user says of the capture itself, for `open_source`."""
    return {
        "format": arguments.format, "baud": arguments.baud, "channels": arguments.channel, "inverted": arguments.inverted,
        "uart": arguments.uart,
    }  # fmt: skip


def open_reading(path: str, arguments: argparse.Namespace, follow: Follow | None = None) -> OpenCapture:
    """Open a capture and choose its dialects. `follow`: the capture is a log that is still being written.

    Raises UnreadableError for what cannot be read, UsageError for options that do not fit it.
    """
    from analyzer.sources import open_source

    source = open_source(path, **source_options(arguments))
    try:
        if follow is not None and source.kind != "log":
            raise UsageError(f"--follow: {source.name} is {source.title}, and only a log (MCAP) can be followed")
        source.follow = follow
        return OpenCapture(source, arguments)
    except BaseException:
        source.close()
        raise


@contextmanager
def progress(source: Source, what: str, frames: Callable[[], int] | None = None) -> Iterator[None]:
    """Show progress on the terminal while something longer than a second runs; quiet elsewhere."""
    if not sys.stderr.isatty() or source.size is None:
        yield
        return
    with showing_progress(what, source.size, source.position, frames):
        yield


@contextmanager
def showing_progress(
    what: str | Callable[[], str], total: int, position: Callable[[], int], frames: Callable[[], int] | None = None
) -> Iterator[None]:
    """Show how far something has come, on a terminal, once it takes longer than a second; both counts are bytes.

    `frames`: counts those that are done, if their rate is to be shown.
    """
    started = time.monotonic()

    def rate() -> str:
        return "" if frames is None else f"{frames() / (time.monotonic() - started):,.0f} frames/s"

    def show(done: threading.Event) -> None:
        if done.wait(1.0):
            return
        from rich.markup import escape
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

        from analyzer.cli.console import Console

        shown = TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TextColumn("{task.fields[rate]}")
        with Progress(*shown, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("", total=total, rate="")
            while True:
                described = escape(what if isinstance(what, str) else what())
                bar.update(task, description=described, completed=position(), rate=rate())
                if done.wait(0.2):
                    return

    with meanwhile(show) if sys.stderr.isatty() else nullcontext():
        yield


@contextmanager
def meanwhile(work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Run `work` in a thread for as long as the context lasts. It is given an event, and must end when that is set."""
    done = threading.Event()
    thread = threading.Thread(target=work, args=(done,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def tell_notes(notes: Iterable[str]) -> None:
    """Print what a user should know, beside the output proper."""
    for note in notes:
        print(f"note: {printable(note)}", file=sys.stderr)


def now_text() -> str:
    """Return the time of day in UTC for a log's metadata."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
