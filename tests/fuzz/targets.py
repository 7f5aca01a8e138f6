"""Targets: what is run on an input, and what must hold then.

Every command ends with 0, 1 or 2. It prints no traceback and no ESC, and leaves no file out of all proportion. The engine
bounds time and memory. Some targets state more:

    framer    each byte stands in one frame or piece of junk, in order, however the bytes were cut
    pipeline  the same, for any capture, behind its source
    columns   by blocks comes out what frame by frame does; of a serial line, what chunk by chunk does
    decode    the same, in the log as the library `mcap` reads it
    device-tables   a table of a kind that is written has the rows of all other kinds
    recover   the result can be read by the library; each record that is whole in the spools stands in it (where bytes alone
              were changed, and no checksum made to fit)
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pickle
import random
import re
import shutil
import traceback
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from unittest import mock

from analyzer import dialects
from analyzer.context import Context
from analyzer.decoder import Decoder
from analyzer.errors import ServotapError
from analyzer.framer import Framer
from analyzer.live import spool
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Frame
from analyzer.sources import FORMATS, open_source
from analyzer.transactions import Transactions
from conformance.claim import RigFault
from tests.bytestreams import SERIAL
from tests.collect import Collect
from tests.columns.both_ways import same_capture, same_line, short_runs
from tests.columns.serial_traffic import chunks_of
from tests.fuzz import devices, fleet, pages
from tests.fuzz.corpus import INPUT, Input, lay_out
from tests.fuzz.running import Fault, Place, Run, Target, check_log, command, fed, heard_words, messages, run_words
from tests.fuzz.seeds import (
    FILES,
    LOG,
    bytes_of_recording_changed,
    bytes_seeds,
    capture_of,
    captures_with,
    device_seeds,
    file_changed,
    file_seeds,
    frames_changed,
    levels_seeds,
    line_changed,
    line_seeds,
    lines,
    mf4_seeds,
    pastes,
    recording_changed,
    recording_seeds,
    recordings,
    rows_changed,
    troubled,
    two_logs,
)
from tests.fuzz.two_ends import beside, can_bus, datagrams, far_end, free_port, program, tcp_clients, viewed

# --- commands ---------------------------------------------------------------------------------------------------------


def _decode(given: Input, place: Place) -> None:
    lay_out(given, place.folder)
    # The summary in words takes as long as the decoding.
    told = ["--json"] * (zlib.crc32(given[INPUT]) % 4 > 0)
    if run_words(("decode", INPUT, "-o", "out.mcap", *told), place) == 0:
        check_log(place.folder / "out.mcap", fed(place.folder / INPUT))


def _copied(*words: str) -> Run:
    """Return a target of a command that makes a log, which the library must read."""

    def run(given: Input, place: Place) -> None:
        lay_out(given, place.folder)
        if run_words((*words, "-o", "out.mcap"), place) == 0:
            for _ in messages(place.folder):
                pass

    return run


def _exported(to: str) -> Run:
    """Return a target of an export whose bytes must be those of the capture, read back."""

    def run(given: Input, place: Place) -> None:
        lay_out(given, place.folder)
        if run_words(("export", INPUT, "--to", to, "-o", "out"), place) == 0:
            before, after = fed(place.folder / INPUT), fed(place.folder / "out", to)
            if before != after:
                raise Fault(f"other bytes come back: {before} were exported, {after} read")

    return run


# --- framer, pipeline ---------------------------------------------------------------------------------------------------

WIRES = [(name,) for name in SERIAL] + [("mks-rs485", "mks-modbus"), SERIAL]


def _framer(given: Input, place: Place) -> None:
    data = given[INPUT]
    # Cuts and dialects follow from the bytes, so that the file alone repeats a fault.
    chance = random.Random(zlib.crc32(data))
    names = chance.choice(WIRES)
    cuts = sorted({0, *(chance.randint(0, len(data)) for _ in range(chance.choice((0, 1, 5, 40))))})
    pieces = [data[a:b] for a, b in zip(cuts, [*cuts[1:], len(data)], strict=True) if a < b]
    at_once, in_pieces = (_line_of(names).take(each) for each in ([data] if data else [], pieces))
    for events in (at_once, in_pieces):
        if b"".join(data for _, data in events) != data:
            raise Fault(f"{len(data)} bytes came in, other bytes came out: {events}")
    if at_once != in_pieces:
        raise Fault(f"cut into {len(pieces)} pieces it gives other frames")


class _Line:
    """A line with all that is behind it; making it takes longer than most inputs, so it is used again."""

    def __init__(self, names: Sequence[str]) -> None:
        self._context = Context()
        self._decoders = {name: Decoder(dialects.get(name)) for name in names}
        self._framer = Framer("line", [dialects.get(name) for name in names], self._context)
        self._fresh = pickle.dumps(self._framer.state())

    def take(self, pieces: Sequence[bytes]) -> list[tuple[int, bytes]]:
        """Return frames and junk with their places."""
        self._context.__init__()  # type: ignore[misc]
        self._framer.restore(pickle.loads(self._fresh))
        transactions = Transactions(self._context, timed=False)
        found = []
        for events in (*(self._framer.feed(Chunk(None, "line", piece)) for piece in pieces), self._framer.close()):
            for event in events:
                found.append((event.offset, event.data))
                if isinstance(event, Frame):
                    message, asked = self._decoders[event.dialect.name].decode(event, self._context)
                    transactions.observe(message, len(found), asked)
        return found


_line_of = cache(_Line)


def placed(sink: Collect) -> dict[str, list[tuple[int, bytes]]]:
    """Return the frames and junk of each bus in the order of their places. Raises Fault for a byte lost or doubled."""
    events: dict[str, list[tuple[int, bytes]]] = {}
    for each in (*(e.message.frame for e in sink.entries), *sink.pieces):
        events.setdefault(each.port, []).append((each.offset, each.data))
    for bus, found in events.items():
        found.sort(key=lambda event: event[0])
        for (at, data), (following, _) in itertools.pairwise(found):
            if at + len(data) != following:
                raise Fault(f"bytes {at} to {at + len(data)} of {bus} are followed by {following}")
    return events


#: All but MF4, which takes a process for each.
_FORMATS = [name for name in FORMATS if name != "mf4"]


def _pipeline(given: Input, place: Place) -> None:
    lay_out(given, place.folder)
    sink, sizes, kinds = Collect(), dict[str, int](), set[str]()
    # Half of the inputs are read as a format that they most often are not; to find out which they are takes longest.
    chance = random.Random(zlib.crc32(given[INPUT]))
    format = chance.choice(_FORMATS) if chance.random() < 0.5 else None
    try:
        with open_source(place.folder / INPUT, format=format, baud=115200) as source:
            items = [item for item in source if isinstance(item, (Chunk, CanFrame))]
    except ServotapError:
        return
    for item in items:
        sizes[item.port] = sizes.get(item.port, 0) + len(item.data)
        kinds.add("can" if isinstance(item, CanFrame) else "serial")
    if len(kinds) == 1 and source.kind != "log":
        chosen = [d for d in dialects.every() if d.bus in kinds]
        Pipeline(chosen, (sink,), Options()).run(items)
        found = {bus: sum(len(data) for _, data in events) for bus, events in placed(sink).items()}
        if {bus: size for bus, size in found.items() if size} != {bus: size for bus, size in sizes.items() if size}:
            raise Fault(f"{sizes} bytes came in, {found} came out")


def _columns(given: Input, place: Place) -> None:
    path = place.folder / INPUT
    lay_out(given, place.folder)
    try:
        with short_runs():
            same_capture(path, dialects.get("mks-can"))
    except AssertionError as error:
        raise Fault(f"by blocks comes something else: {error}") from error


def _columns_serial(given: Input, place: Place) -> None:
    data = given[INPUT]
    chance = random.Random(zlib.crc32(data))
    dialect = dialects.get(chance.choice(SERIAL))
    chunks = list(chunks_of(data, chance, longest=chance.choice((3, 40, 5000))))
    try:
        with short_runs():
            same_line(chunks, dialect, chance.choice((2, 50, 10_000)), timed=chance.random() < 0.7)
    except AssertionError as error:
        raise Fault(f"by blocks comes something else: {error}") from error


# --- recover ------------------------------------------------------------------------------------------------------------


def _recover(given: Input, place: Place) -> None:
    lay_out(given, place.folder)
    status, said = heard_words(("recover", LOG), place)
    if status == 0:
        for _ in messages(place.folder):
            pass
    elif b"the result cannot be read back" in said:
        raise Fault(said.decode("utf-8", "replace"))


def _recover_bytes(given: Input, place: Place) -> None:
    """What is whole in the spools must stand in the log: bytes were damaged, so a record is whole if its checksum fits."""
    wanted = [data for name, text in given.items() if ".spool/1-left." in name for data in whole_records(text)]
    lay_out(given, place.folder)
    if run_words(("recover", LOG), place) != 0:
        return
    # Of each log the bytes as they came: each record of these recordings has bytes that no other has.
    stands = b"".join(
        bytes.fromhex(json.loads(text).get("_raw", "")) for topic, text in messages(place.folder) if topic == "/left/raw"
    )
    lost = [data for data in wanted if data not in stands]
    if lost:
        raise Fault(f"a whole record of a spool is not in the log: {lost[0].hex(' ')} and {len(lost) - 1} more")


def whole_records(data: bytes) -> Iterator[bytes]:
    """Yield the bytes of each serial record whose checksum fits, wherever it begins."""
    at = data.find(spool.MAGIC)
    while at >= 0 and at + spool.HEAD.size <= len(data):
        magic, kind, size, t_ns, before, _ = spool.HEAD.unpack_from(data, at)
        payload = data[at + spool.HEAD.size :][:size]
        if kind == spool.RecordKind.DATA and spool.pack(kind, t_ns, before, payload) == data[at : at + spool.HEAD.size + size]:
            yield payload
        at = data.find(magic, at + 1)


# --- command lines ------------------------------------------------------------------------------------------------------


def _words(given: Input, place: Place) -> None:
    try:
        words = [str(word).replace("\0", "") for word in json.loads(given[INPUT])]
    except (ValueError, TypeError):
        return  # shrinking and libFuzzer cut it anywhere
    for name, capture in FILES.items():
        (place.folder / name).write_bytes(capture_of(capture))
    run_words(words, place)


# --- the table ------------------------------------------------------------------------------------------------------------


def _on_files(*words: str, run: Run | None = None, kinds: Sequence[str] = (), share: float = 1.0, forks: bool = True) -> Target:
    return Target(run or command(*words), file_seeds("decode", *words[:1], kinds=kinds), file_changed, share, forks=forks)


_LOGS = ("mcap",)


def _far(*words: str, share: float = 1.0) -> Target:
    """Return a target of a command that talks to the far end of a bus; that may hang up, which is no fault."""

    def run(given: Input, place: Place) -> None:
        with far_end(given[INPUT]) as endpoint:
            run_words([word.replace("ENDPOINT", endpoint) for word in words], place, _ON_A_BUS)

    return Target(run, bytes_seeds, frames_changed, share, 30.0)


_ON_A_BUS = (0, 1, 2, RigFault.exit_status)
#: Emulated drives of each serial dialect; which one follows from the bytes.
_DRIVES = ("mks-rs485@1", "mks-modbus@1", "lk-rs485@1", "mks-rs485@1,work_mode=sr_vfoc")


def _emulate(kind: str, given: Input, place: Place) -> None:
    data = given[INPUT]
    drive = _DRIVES[zlib.crc32(data) % len(_DRIVES)]
    with contextlib.ExitStack() as stack:
        if kind == "tcp":
            port = free_port()
            where, act = f"127.0.0.1:{port}", tcp_clients(port, data)
        elif kind == "can":
            (where, port), drive = can_bus(), "mks-can@1"
            act = datagrams(port, data)
        else:
            where, act = "link", program(place.folder / "link", data)
        stack.enter_context(beside(act))
        run_words(("emulate", drive, f"--{kind}", where, "--duration", "0.2", "--log", "out.mcap"), place)


def _tap(given: Input, place: Place) -> None:
    data = given[INPUT]
    with far_end(data) as endpoint, beside(program(place.folder / "link", data[::-1])):
        words = ("tap", f"{endpoint},baud=38400", "--link", "link", "--duration", "0.5", "-o", "out.mcap")
        run_words(words, place)
    for _ in messages(place.folder):
        pass


def _replay(given: Input, place: Place) -> None:
    lay_out(given, place.folder)
    words = ("replay", INPUT, "--speed", "1000000", "--skip-refused", "--on")
    with far_end(given["far"]) as endpoint:
        run_words((*words, f"{endpoint},baud=38400"), place, _ON_A_BUS)


def _view(given: Input, place: Place) -> None:
    lay_out(given, place.folder)
    with contextlib.suppress(ServotapError):
        viewed(place.folder / INPUT, given["keys"])


TARGETS: dict[str, Target] = {
    "framer": Target(_framer, bytes_seeds, frames_changed, 10.0, 5.0),
    "pipeline": Target(_pipeline, file_seeds("decode"), file_changed, 10.0),
    "columns": Target(_columns, file_seeds("decode", kinds=("blf", "candump", "pcap")), file_changed, 3.0),
    "columns-serial": Target(_columns_serial, bytes_seeds, frames_changed, 3.0),
    "decode": Target(_decode, file_seeds("decode"), file_changed, 3.0),
    "decode-parquet": _on_files("decode", INPUT, "--to", "parquet", "-o", "out.parquet", share=0.5, forks=False),
    "show": _on_files("show", INPUT),
    "levels": Target(command("show", INPUT), levels_seeds, file_changed, 2.0),
    "show-json": _on_files("show", INPUT, "--json", "--bytes", "--since", "+1s"),
    "diagnose": _on_files("diagnose", INPUT, "--json"),
    "troubles": Target(command("diagnose", INPUT, "--json"), pastes, troubled, 3.0),
    "report": Target(pages.reported, file_seeds("decode", "report"), file_changed, 2.0),
    "plot": _on_files("plot", INPUT, "*"),
    "plot-picture": _on_files("plot", INPUT, "*", "-o", "out.svg", share=0.3),
    "ingest": Target(fleet.taken, file_seeds("decode", "ingest"), file_changed, 1.0, forks=False),
    "ask": Target(fleet.asked, fleet.questions, fleet.question_changed, 2.0, forks=False),
    "lake": Target(fleet.lake_of, fleet.lakes, fleet.lake_changed, 1.0, forks=False),
    "wireshark": Target(pages.dissected, bytes_seeds, frames_changed, 0.3, 60.0, forks=False),
    "export-csv": _on_files("export", INPUT, "-o", "out.csv"),
    "export-wide": _on_files("export", INPUT, "-o", "out.csv", "--wide", "--rate", "10Hz", share=0.5),
    "export-parquet": _on_files("export", INPUT, "-o", "out.parquet", share=0.5, forks=False),
    "export-xlsx": _on_files("export", INPUT, "-o", "out.xlsx", share=0.5),
    "export-candump": _on_files("export", INPUT, "--to", "candump", "-o", "-"),
    "export-pcapng": _on_files("export", run=_exported("pcapng")),
    "export-hex": _on_files("export", INPUT, "--to", "hex", "-o", "-"),
    "check": _on_files("check", INPUT, share=0.5),
    "replay": _on_files("replay", INPUT, "--on", "serial:none", "--dry-run", share=0.5),
    "far-send": _far("send", "mks-rs485@1", "read_speed", "--on", "ENDPOINT,baud=38400", "--timeout", "50"),
    "far-scan": _far("scan", "ENDPOINT,baud=38400", "--addresses", "1", share=0.5),
    "far-record": _far("record", "ENDPOINT,baud=38400", "--duration", "0.3", "-o", "out.mcap", share=0.3),
    "emulate-tcp": Target(partial(_emulate, "tcp"), bytes_seeds, frames_changed, 0.5, 30.0),
    "emulate-pty": Target(partial(_emulate, "pty"), bytes_seeds, frames_changed, 0.5, 30.0),
    "emulate-can": Target(partial(_emulate, "can"), bytes_seeds, frames_changed, 0.5, 30.0),
    "tap": Target(_tap, bytes_seeds, frames_changed, 0.5, 30.0),
    "replay-bus": Target(_replay, captures_with("far", "replay-bus"), file_changed, 0.5, 30.0),
    "view": Target(_view, captures_with("keys", "view"), file_changed, 0.5, 30.0),
    "device-files": Target(devices.decoded, device_seeds, rows_changed, 1.0, 30.0),
    "device-tables": Target(devices.tabled, device_seeds, rows_changed, 0.5, 30.0, forks=False),
    "mf4": Target(command("show", INPUT), mf4_seeds, file_changed, 0.3, forks=False),
    "cut": _on_files("cut", run=_copied("cut", INPUT, "--since", "+1ms"), kinds=_LOGS),
    "merge": Target(_copied("merge", INPUT, "other"), two_logs, file_changed),
    "recover": Target(_recover, recording_seeds, recording_changed, 3.0, 30.0),
    "recover-bytes": Target(_recover_bytes, recordings, bytes_of_recording_changed, 3.0, 30.0),
    **{name: Target(_words, partial(line_seeds, name), line_changed, seconds=30.0) for name in lines()},
}  # fmt: skip


def attempt(name: str, given: Input, folder: Path, said: Callable[[], bytes]) -> str:
    """Run a target on an input in an empty folder, and empty it again; return what is wrong, nothing if all holds."""
    try:
        with contextlib.chdir(folder), mock.patch.dict(os.environ, SERVOTAP_FAULTS=str(folder)):
            TARGETS[name].run(given, Place(folder, said))
    except Fault as fault:
        return str(fault)
    except BaseException:
        return traceback.format_exc()
    finally:
        said()
        for entry in os.scandir(folder):
            shutil.rmtree(entry.path) if entry.is_dir(follow_symlinks=False) else os.unlink(entry.path)
    return ""


_AT = re.compile(r'File "([^"]*)", line (\d+),? in (\S+)')


def key_of(fault: str) -> str:
    """Return the same word for the same fault: the kind of the error and the function of this program that it came from."""
    places = [(path, function) for path, _, function in _AT.findall(fault) if "/tests/fuzz/" not in path]
    own = [
        f"{Path(path).stem}.{function.strip('<>')}" for path, function in places if re.search(r"/(analyzer|conformance)/", path)
    ]
    if fault.startswith(("Fatal", "Current", "Thread", "hang")):
        return f"hang-{own[0]}" if own else "hang"
    kind = re.findall(r"^([A-Za-z_.]+)(?::|$)", fault.rstrip().rpartition("\n")[2])
    if own and kind:
        return f"{kind[0].rpartition('.')[2]}-{own[-1]}"
    return re.sub(r"[^a-z]+", "-", fault.splitlines()[-1].lower().partition(":")[0])[:50].strip("-") or "fault"
