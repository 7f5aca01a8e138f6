"""Spools for tests, written as readers write them, and the logs that are made of them."""

from __future__ import annotations

import json
import random
from pathlib import Path

from mcap.reader import make_reader

from analyzer.live import config
from analyzer.live.config import CONTROL, PortConfig, RecordingConfig
from analyzer.live.log_parts import LogParts
from analyzer.live.recorder import Recorder
from analyzer.live.recording import Recording
from analyzer.live.spool import RecordKind, SpoolWriter, pack, pack_can, pack_event, spool_folder
from tests.collect import sum8

MS = 1_000_000
#: Long ago on the monotonic clock, so that nothing has to be waited for.
START = 1_000_000_000
UTC = 1_790_000_000_000_000_000


def port(stem, bus, kind="serial", dialects=("mks-rs485",), **about):
    endpoint = "can:virtual:x" if kind == "can" else "serial:/dev/ttyUSB0"
    return PortConfig(stem=stem, bus=bus, endpoint=endpoint, kind=kind, dialects=dialects, **about)


class Spools:
    """A folder of spools. Times are milliseconds since the start; each spool counts its bytes."""

    def __init__(self, tmp_path, *ports, name="out.mcap", segment_size=1 << 22, **about):
        self.log = Path(tmp_path) / name
        self.folder = spool_folder(self.log)
        self.folder.mkdir()
        self.config = RecordingConfig(log=str(self.log), ports=ports, anchor_monotonic_ns=START, anchor_utc_ns=UTC, **about)
        self.config.save(self.folder)
        self._segment_size = segment_size
        self._writers = {}
        self._counts = {}
        #: What was spooled, by bus.
        self.sent = {}
        self._bus = {p.stem: p.bus for p in ports}
        self._kind = {p.stem: p.kind for p in ports}

    def write(self, stem, record):
        writer = self._writers.get(stem)
        if writer is None:
            writer = self._writers[stem] = SpoolWriter(self.folder, stem, segment_size=self._segment_size)
        writer.write(record)

    def data(self, stem, ms, data):
        data = bytes.fromhex(data) if isinstance(data, str) else data
        before = self._counts.get(stem, 0)
        self.write(stem, pack(RecordKind.DATA, START + int(ms * MS), before, data))
        self._counts[stem] = before + len(data)
        self.sent[self._bus[stem]] = self.sent.get(self._bus[stem], b"") + data

    def can(self, stem, ms, text, flags=0):
        identifier, _, data = text.partition("#")
        before = self._counts.get(stem, 0)
        self.write(stem, pack_can(START + int(ms * MS), before, int(identifier, 16), flags, bytes.fromhex(data)))
        self._counts[stem] = before + 1
        self.sent[self._bus[stem]] = self.sent.get(self._bus[stem], b"") + bytes.fromhex(data)

    def idle(self, stem, ms):
        self.write(stem, pack(RecordKind.IDLE, START + int(ms * MS), self._counts.get(stem, 0), b""))

    def event(self, stem, ms, event, lost=0, **about):
        self._counts[stem] = self._counts.get(stem, 0) + lost
        self.write(stem, pack_event(START + int(ms * MS), self._counts[stem], event, **about))

    def end(self, ms, reason="Ctrl-C"):
        for stem in self._bus:
            self.event(stem, ms, "closed", reason=reason)
        self.event(CONTROL, ms, "end", reason=reason)
        self.close()

    def close(self):
        for writer in self._writers.values():
            writer.close()
        self._writers.clear()

    def record(self, **options):
        """Make the log of what is there; return what a person was told."""
        said = []
        Recorder(self.folder, say=said.append, **options).run()
        return said

    def begin(self):
        """Begin a recording of what is there, or go on with it."""
        told = config.load(self.folder)
        return Recording(self.folder, told, LogParts(self.folder, told))

    def record_in_chunks(self, flush_every):
        """Make the log of what is there, with a flush every so many records."""
        recording = self.begin()
        for number, each in enumerate(recording.merger.take(None)):
            recording.take([each])
            if number % flush_every == 0:
                recording.flush()
        while not recording.merger.drained:
            recording.take(recording.merger.take(None))
        recording.finish(lambda step: step())

    def record_and_be_killed(self, after, flush_every):
        """Record up to a record, and leave everything as a process that is killed then leaves it."""
        recording = self.begin()
        for number, each in enumerate(recording.merger.take(START + 10**12)):
            recording.take([each])
            if number % flush_every == flush_every - 1:
                recording.flush()
            if number == after:
                break
        recording.abandon()


def read(path):
    """Return (topic, message, value) of a log in its order."""
    with open(path, "rb") as stream:
        return [
            (channel.topic, message, json.loads(message.data))
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]


def content(path):
    """Return what a log says of the traffic: all but what came as it came, and the counts of each second."""
    return [(topic, message.sequence, value) for topic, message, value in read(path) if not topic.endswith(("/raw", "/stats"))]


def raw_of(paths, bus):
    """Return the bytes of a bus in its raw topic over several logs, having checked that each stands once and in order."""
    whole = b""
    for path in paths:
        for topic, _, value in read(path):
            if topic == f"/{bus}/raw":
                assert value["_offset"] == len(whole)
                whole += bytes.fromhex(value["_raw"])
    return whole


def decoded_of(paths, bus):
    """Return the bytes of a bus in its frames and junk, by their offsets."""
    pieces = {}
    for path in paths:
        for topic, _, value in read(path):
            if topic.startswith(f"/{bus}/") and not topic.endswith("/raw") and "_raw" in value:
                assert value["_offset"] not in pieces
                pieces[value["_offset"]] = bytes.fromhex(value["_raw"])
    whole = b""
    for offset, data in sorted(pieces.items()):
        assert offset == len(whole)
        whole += data
    return whole


EXCHANGES = (
    (sum8("FA 01 32"), sum8("FB 01 32 FE D4")),
    (sum8("FA 02 31"), sum8("FB 02 31 00 00 00 00 40 00")),
    (sum8("FA 01 F6 01 40 02"), sum8("FB 01 F6 01")),
    (sum8("FA 01 33"), sum8("FB 01 33 00 00 12 34")),
    (sum8("FA 03 30"), ""),
    (sum8("FA 01 F6 0F A0 02"), sum8("FB 01 F6 00")),
    ("00 55", ""),
    (sum8("FA 01 32")[:-2] + "11", ""),
)


def traffic(seed, count):
    """Yield (is request, bytes) of exchanges in good and bad order."""
    chance = random.Random(seed)
    for _ in range(count):
        request, reply = chance.choice(EXCHANGES)
        yield True, bytes.fromhex(request)
        if reply:
            yield False, bytes.fromhex(reply)
