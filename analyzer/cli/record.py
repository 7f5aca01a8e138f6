"""Record serial ports and CAN buses into one MCAP log: decoded, paired, with findings, while it runs. It only listens.

Any number of buses go into one file on one clock. The log is readable while it grows and after a crash; what is lost
(a port unplugged, a full disk) is marked with its times, and the port is reconnected. Ctrl-C ends the recording.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from msgspec import structs

from analyzer import dialects as registry
from analyzer.cli.option_types import (
    Ids,
    add_device_arguments,
    add_group_argument,
    add_ids_argument,
    add_model_argument,
    duration_ns,
    ids_of,
    is_size,
    milliseconds,
    positive,
    size_bytes,
    utf8,
)
from analyzer.cli.signals import ENDING, handled
from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint, parse_all
from analyzer.live.profile import Named, endpoint, endpoint_texts
from analyzer.values import near, quote, storable

if TYPE_CHECKING:
    from analyzer.catalogue import Dialect
    from analyzer.cli.record_display import Display
    from analyzer.live.config import PortConfig, RecordingConfig
    from analyzer.live.supervisor import ReaderMaker, Supervisor

FOXGLOVE = "127.0.0.1:8765"
#: Some minutes of all buses of a machine while its log cannot be written; a flood fills it in seconds.
MAX_SPOOL = "1GB"
#: A Ctrl-C this soon after the one before belongs to it.
_SAME_PRESS_S = 1.0

EXAMPLES = """\
endpoints:
  [NAME=]serial:PORT,baud=N[,parity=even|odd][,stop=2][,direction=request|reply]     baud=auto listens at each rate
  [NAME=]serial:,serial=NUMBER,baud=N              a USB adapter by its serial number, at any port
  [NAME=]tcp:HOST:PORT[,baud=N]                    a serial line behind a terminal server
  [NAME=]can:INTERFACE:CHANNEL[,bitrate=N]         python-can's interfaces; the option names are python-can's
  NAME                                             a bus or a drive of a profile, servotap.toml (see servotap init)

examples:
  servotap record serial:/dev/ttyUSB0,baud=38400
  servotap record left=serial:/dev/ttyUSB0,baud=38400 arm=can:slcan:/dev/ttyACM0,bitrate=500000 -o week.mcap
  servotap record serial:/dev/ttyUSB0,baud=auto --duration 10min --dialect mks-rs485
  servotap record left=serial:/dev/ttyUSB0,baud=115200,direction=request left=serial:/dev/ttyUSB1,baud=115200,direction=reply
  servotap record can:socketcan:can0 --rotate 100MB --keep 20 -o log.mcap
  servotap record tcp:192.168.0.7:5000 --json --raw-only --max-total 200GB
  servotap record serial:/dev/ttyUSB0,baud=38400 --view
  servotap record can:socketcan:can0 --ids 1,2,0x123-0x12F

exit status: 0 the log has all traffic, 1 traffic was lost (see the summary), 2 wrong use, or its output could not be
written (the log is kept)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("endpoints", nargs="*", type=utf8, metavar="[NAME=]ENDPOINT", help="what to record, see below")
    add_recording_arguments(parser)


def add_recording_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command that records."""
    parser.add_argument(
        "-o", "--output", type=utf8, metavar="OUT.mcap", help="the log, or a folder (default recording-DATE-TIME.mcap)"
    )
    parser.add_argument("--dialect", default="auto", metavar="D", help="auto (default), or the dialects on the buses: D,D")
    add_model_argument(parser, default="")
    add_group_argument(parser)
    add_ids_argument(parser)
    add_device_arguments(parser)
    parser.add_argument("--late", type=milliseconds, default=1000.0, metavar="MS", help="late replies: after MS (default 1000)")
    parser.add_argument("--duration", metavar="TIME", help="stop after 10s, 5min, 2h")
    parser.add_argument("--rotate", metavar="SIZE|TIME", help="a new file every 100MB or 10min, or both: 100MB,10min")
    parser.add_argument("--keep", type=positive, default=0, metavar="N", help="with --rotate: keep the last N files")
    parser.add_argument("--max-total", metavar="SIZE", help="delete the oldest files beyond a total SIZE, as 200GB")
    parser.add_argument(
        "--max-spool", default=MAX_SPOOL, metavar="SIZE",
        help=f"what may wait for decoding; more is dropped, counted and told (default {MAX_SPOOL})",
    )  # fmt: skip
    parser.add_argument("--raw-only", action="store_true", help="store raw traffic without decoding it")
    parser.add_argument("--force", action="store_true", help="replace a log that exists")
    parser.add_argument("--json", action="store_true", help="one line of JSON per second, and a summary")
    parser.add_argument("--view", action="store_true", help="watch in the terminal: frames, counts, findings, plot")
    parser.add_argument(
        "--foxglove", nargs="?", const=FOXGLOVE, default="", metavar="HOST:PORT", help=f"live to Foxglove (default {FOXGLOVE})"
    )


def run(arguments: argparse.Namespace) -> int:
    """Record until the end is asked for; return 0, or 1 if something was lost."""
    display = display_of(arguments, "record")
    endpoints, named = _endpoints(arguments)
    target = target_of(arguments)
    notes: list[str] = []
    if arguments.foxglove:
        from analyzer.sinks.foxglove_live import read_place, require_foxglove

        place = read_place(arguments.foxglove)
        require_foxglove()
        if not place.loopback:
            notes.append(f"foxglove: anyone who can reach {place} can watch")
    dialects = dialects_of(arguments, endpoints, named)
    endpoints = [_at_its_speed(e, dialects[e.name], notes, quiet=arguments.json) for e in endpoints]
    config = configure(arguments, endpoints, target, notes, named)
    return record(config, display, duration_ns=asked_duration_ns(arguments), replaces=arguments.replaces, names=arguments.names)


def display_of(arguments: argparse.Namespace, command: str) -> Display:
    """Return how the recording is to be shown. Raises UsageError where that cannot be."""
    from analyzer.cli.record_display import Display, JsonDisplay, TableDisplay, ViewDisplay

    if arguments.view and arguments.json:
        raise UsageError("--view and --json exclude each other")
    if arguments.view:
        from analyzer.view import require_terminal

        require_terminal(f"servotap {command} --view")
        return ViewDisplay()
    return JsonDisplay() if arguments.json else TableDisplay() if sys.stdout.isatty() else Display()


def asked_duration_ns(arguments: argparse.Namespace) -> int:
    """Return how long to record, 0 without an end."""
    text = arguments.duration or ""
    # A bare number is seconds, as in `emulate`.
    return duration_ns(f"{text}s" if text.replace(".", "", 1).isdigit() else text) if text else 0


def record(
    config: RecordingConfig,
    display: Display,
    *,
    duration_ns: int = 0,
    readers: ReaderMaker | None = None,
    replaces: Sequence[Path] = (),
    names: Iterable[Path] = (),
) -> int:
    """Record as configured; return the exit status. Signals end it in order. `readers`, `replaces`: see `Supervisor`.

    `names`: what else the log may be called, where another recording takes its name before this one begins. Raises the
    OSError of a line that could not be printed, once the log is whole.
    """
    from analyzer.cli.record_report import summarize
    from analyzer.live.supervisor import Supervisor, Taken

    def made(config: RecordingConfig) -> Supervisor:
        return Supervisor(
            config,
            duration_ns=duration_ns,
            on_note=display.note,
            on_snapshot=display.snapshot,
            readers=readers,
            replaces=replaces,
        )

    supervisor, others = made(config), iter(names)
    ending = _Ending(supervisor, display.say)
    with handled(ending):
        while True:
            try:
                supervisor.start()
                break
            except Taken:
                other = next(others, None)
                if other is None:
                    raise
                asked, supervisor = supervisor.reason, made(structs.replace(config, log=str(other.absolute())))
                ending.supervisor = supervisor
                if asked:
                    supervisor.stop(asked)
        # First: a reader of what is shown may stall.
        thread = threading.Thread(target=supervisor.run, name="supervisor")
        thread.start()
        try:
            display.begin(supervisor)
            display.watch(supervisor, thread)
        finally:
            supervisor.stop("the display broke off")
            thread.join()
            display.tell_notes()
    summary = summarize(supervisor)
    display.end(summary)
    if display.unprinted is not None:
        raise display.unprinted
    return 1 if summary.lost else 0


class _Ending:
    """Ends a recording at a signal.

    The second signal says that the log is being finished. A third Ctrl-C leaves that to `servotap recover`.
    """

    def __init__(self, supervisor: Supervisor, say: Callable[[str], None]) -> None:
        self.supervisor = supervisor
        self._say = say
        self._told = 0.0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.supervisor.reason:
            self.supervisor.stop(ENDING[number])
        elif not self._told:
            self._told = time.monotonic()
            self._say("finishing the log; press Ctrl-C again to leave that to servotap recover")
        elif number == signal.SIGINT and time.monotonic() - self._told > _SAME_PRESS_S:
            self.supervisor.give_up()


# --- what was asked for ---------------------------------------------------------------------------------------------------


def _endpoints(arguments: argparse.Namespace) -> tuple[list[Endpoint], list[Named]]:
    """Return what is recorded, and what the names of a profile among it stand for."""
    texts = list(arguments.endpoints)
    if arguments.foxglove:
        # `--foxglove serial:...`: the endpoint is none of Foxglove's.
        with contextlib.suppress(UsageError):
            endpoint(arguments.foxglove)
            texts.append(arguments.foxglove)
            arguments.foxglove = FOXGLOVE
    replaced, named = endpoint_texts(texts)
    return parse_all(replaced), named


def target_of(arguments: argparse.Namespace) -> Path:
    """Return the log to write. Raises UsageError where something is in the way."""
    target = Path(arguments.output or "")
    if target.is_dir():
        names = _numbered(target / time.strftime("recording-%Y%m%d-%H%M%S.mcap"))
        arguments.replaces, arguments.mode, arguments.names = [], None, names
        target = next(names)
        _in_the_way(target, force=False)
        return target
    arguments.names = ()
    if target.suffix != ".mcap" and (target.is_file() or not target.exists()):
        raise UsageError(f"got {str(target)!r}, expected a name that ends in .mcap")
    if target.is_symlink() and target.exists():
        # The link stays: the file behind it is written.
        target = target.resolve()
    arguments.replaces = _in_the_way(target, arguments.force, parts=bool(arguments.rotate or arguments.max_total))
    logs = [path for path in arguments.replaces if path.is_file()]
    arguments.mode = stat.S_IMODE(logs[-1].stat().st_mode) if logs else None
    return target


def _numbered(log: Path) -> Iterator[Path]:
    """Yield names for a log that has none: this one, then the same with a number, without those that are taken."""
    from analyzer.live.spool import spool_folder
    from analyzer.sources.recording_parts import parts_named

    for number in count(1):
        name = log if number == 1 else log.with_stem(f"{log.stem}-{number}")
        if not (os.path.lexists(name) or spool_folder(name).exists() or parts_named(name)):
            yield name


def _in_the_way(log: Path, force: bool, *, parts: bool = False) -> list[Path]:
    """Return what a log replaces: itself, with `parts` those of its name, and the spools of an unfinished recording.

    Raises UsageError where the log cannot be written, or where something is in the way without `force`.
    """
    from analyzer.live.lock import running
    from analyzer.live.spool import spool_folder
    from analyzer.sources.recording_parts import parts_named

    if log.is_symlink() and not log.exists():
        raise UsageError(f"{log} is a link that leads to no file; name the file itself")
    if log.exists() and not log.is_file():
        raise UsageError(f"{log} is not a regular file: cannot write a log there")
    if not log.parent.is_dir():
        raise UsageError(f"{log.parent} is no folder")
    if not os.access(log.parent, os.W_OK):
        raise UsageError(f"{log.parent}: no permission to write there")
    found = []
    folder = spool_folder(log)
    if folder.exists():
        if running(folder):
            raise UsageError(f"a recording to {log} is running")
        if not force:
            raise UsageError(
                f"{folder} exists: a recording to {log} was interrupted; servotap recover {log} repairs it, --force deletes it"
            )
        found.append(folder)
    for path in parts_named(log) if parts else [log]:
        if path.exists():
            if not force:
                raise UsageError(f"{path} exists; --force replaces it")
            found.append(path)
    return found


def _at_its_speed(endpoint: Endpoint, dialects: Sequence[Dialect], notes: list[str], *, quiet: bool) -> Endpoint:
    """Return an endpoint with its rate: found out where it says `auto`, where it says none the default, and that is told."""

    def say(text: str) -> None:
        notes.append(f"{endpoint.name}: {text}")
        if not quiet:
            print(f"{endpoint.name}: {text}", file=sys.stderr, flush=True)

    if not endpoint.auto:
        if endpoint.kind != "serial" or endpoint.speed is not None:
            return endpoint
        defaults = {dialect.baud_rates[0] for dialect in dialects}
        baud = defaults.pop() if len(defaults) == 1 else endpoint.bits_per_second
        say(f"no baud given: {baud} is taken (baud=auto listens at each rate)")
        return replace(endpoint, speed=baud, text=f"{endpoint.text},baud={baud}")
    from analyzer.live.autobaud_ports import find

    return find(endpoint, say=say, candidates=list(dialects) or None).endpoint


def configure(
    arguments: argparse.Namespace,
    endpoints: Sequence[Endpoint],
    target: Path,
    notes: Sequence[str],
    named: Sequence[Named] = (),
) -> RecordingConfig:
    """Return the configuration of a recording of endpoints that begins now. `notes` go into the log.

    `named`: what the profile says of them; it counts where the options say nothing.
    """
    from analyzer.devices import described, read
    from analyzer.live.clock import checked_utc, now
    from analyzer.live.config import RecordingConfig

    devices = read(arguments.dbc, arguments.modbus_map)
    notes = list(notes)
    described(devices, notes.append)
    dialects = dialects_of(arguments, endpoints, named)
    model = arguments.model or ",".join(dict.fromkeys(d.entry.model for each in named for d in each.drives if d.entry.model))
    if model:
        registry.for_model([d for each in dialects.values() for d in each] or registry.every(), model)
    ids = _ids(arguments.ids or [f"{each.endpoint.name}={each.bus.ids}" for each in named if each.bus.ids], endpoints)
    groups = dict.fromkeys((*arguments.group, *(group for each in named for group in each.bus.groups)))
    rotate_bytes, rotate_ns = _rotation(arguments)
    anchor = now()
    checked_utc(anchor.wall_ns)
    return RecordingConfig(
        log=str(target.absolute()),
        ports=tuple(_port(number, e, dialects[e.name], ids) for number, e in enumerate(endpoints, 1)),
        anchor_monotonic_ns=anchor.monotonic_ns,
        anchor_utc_ns=anchor.wall_ns,
        model=model,
        groups=tuple(groups),
        late_ns=int(arguments.late * 1e6),
        raw_only=arguments.raw_only,
        rotate_bytes=rotate_bytes,
        rotate_ns=rotate_ns,
        keep=arguments.keep,
        max_total=size_bytes(arguments.max_total) if arguments.max_total else 0,
        max_spool=size_bytes(arguments.max_spool),
        mode=arguments.mode,
        foxglove=arguments.foxglove,
        command=storable(shlex.join(["servotap", *sys.argv[1:]])),
        notes=tuple(notes),
        devices=tuple(devices),
    )


def _ids(texts: Sequence[str], endpoints: Sequence[Endpoint]) -> Ids:
    ids, names = ids_of(texts), [endpoint.name for endpoint in endpoints]
    for bus in ids.by_bus:
        if bus not in names:
            raise UsageError(f"--ids: no bus {quote(bus)}{near(bus, names)}, expected {' or '.join(dict.fromkeys(names))}")
    return ids


def _port(number: int, endpoint: Endpoint, dialects: Sequence[Dialect], ids: Ids) -> PortConfig:
    from analyzer.live.can_listen_only import NO_BITRATE
    from analyzer.live.config import PortConfig

    direction = endpoint.direction.value
    listed = ids.of(endpoint.name)
    speed: int | None = endpoint.bits_per_second
    if endpoint.kind == "tcp" or (endpoint.kind == "can" and endpoint.interface[0] in NO_BITRATE):
        speed = endpoint.speed
    return PortConfig(
        stem=f"{number}-{endpoint.name}" + (f"-{direction}" if direction != "unknown" else ""),
        bus=endpoint.name,
        endpoint=endpoint.text.replace("baud=auto", f"baud={endpoint.bits_per_second}"),
        kind=endpoint.bus_kind,
        direction=direction,
        speed=speed,
        byte_ns=endpoint.byte_ns,
        dialects=tuple(d.name for d in dialects),
        ids=None if listed is None else tuple(sorted(listed)),
    )


def dialects_of(
    arguments: argparse.Namespace, endpoints: Sequence[Endpoint], named: Sequence[Named] = ()
) -> dict[str, list[Dialect]]:
    """Return the dialects of each bus: those of --dialect, else those of its drives in the profile; none: to be found out."""
    if arguments.dialect == "auto":
        drives = [(each.endpoint.name, drive.dialect) for each in named for drive in each.drives]
        return {e.name: list({d.name: d for bus, d in drives if bus == e.name}.values()) for e in endpoints}
    chosen = [registry.get(name.strip()) for name in arguments.dialect.split(",")]
    kinds = {e.bus_kind for e in endpoints}
    for dialect in chosen:
        if dialect.bus not in kinds:
            raise UsageError(f"{dialect.name} is a dialect of {dialect.bus} buses, and none is recorded")
    return {e.name: [d for d in chosen if d.bus == e.bus_kind] for e in endpoints}


def _rotation(arguments: argparse.Namespace) -> tuple[int, int]:
    size = time_ns = 0
    for part in arguments.rotate.split(",") if arguments.rotate else ():
        if is_size(part):
            size = size_bytes(part)
        else:
            try:
                time_ns = duration_ns(part)
            except UsageError:
                raise UsageError(f"--rotate: got {part!r}, expected a size as 100MB or a time as 10min") from None
    if arguments.keep and not arguments.rotate:
        raise UsageError("--keep needs --rotate")
    return size, time_ns
