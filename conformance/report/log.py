"""A run as an MCAP log: all traffic, decoded, and on `/tests` the time and verdict of each claim.

Each claim gets new emulated drives, whose time begins at 0; in the log the claims follow one another. `servotap rerun` takes
the log of one refuted claim; its metadata name the claim and the drive.
"""

from __future__ import annotations

import calendar
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.cli.output import whole
from analyzer.errors import UsageError
from analyzer.live.clock import checked_utc
from analyzer.pipeline import Pipeline
from analyzer.port import PortSetup, topic_name
from analyzer.records import CanFrame, Chunk
from analyzer.sinks.mcap_file import McapFile
from analyzer.sinks.mcap_log import LIBRARY, PROFILE, McapLog
from conformance.claim import Outcome
from conformance.suite.record import RunRecord, VerdictRecord

TOPIC = "/tests"
#: Name of the metadata record that says what a log's claim was, for `servotap rerun`.
METADATA = "servotap.claim"
#: Between two claims that do not share a clock.
_PAUSE_NS = 10_000_000
_TEXT = {"type": "string"}
_SCHEMA = {
    "type": "object",
    "title": "servotap.test",
    "properties": {
        "event": {"type": "string", "description": "begin or end of a claim"},
        "claim": _TEXT,
        "target": {"type": "string", "description": "the drive as it was named"},
        "bus": _TEXT,
        "statement": _TEXT,
        "section": {"type": "string", "description": "of the manual"},
        "certainty": _TEXT,
        "outcome": {"type": "string", "description": "confirmed, refuted, inconclusive, observed"},
        "reason": _TEXT,
        "expected": _TEXT,
        "got": _TEXT,
    },
}


class RunLog:
    """Writes claims one behind the other. `begun_ns`: UTC of the first."""

    def __init__(self, file: McapFile, begun_ns: int) -> None:
        self._file = file
        self._log = McapLog(file)
        schema = file.add_schema("servotap.test", msgspec.json.encode(_SCHEMA))
        self._channel = file.add_channel(TOPIC, schema, {})
        self._last_ns = begun_ns
        self._offset_ns: dict[str, int] = {}
        self._bytes: dict[str, int] = {}
        self._sequence = 0

    def add(self, record: VerdictRecord) -> None:
        """Write one claim: its beginning, its traffic, its end."""
        shift_ns = self._offset_ns.get(record.target, self._last_ns - record.first_ns)
        if record.first_ns + shift_ns < self._last_ns:
            shift_ns = self._last_ns + _PAUSE_NS - record.first_ns
        self._offset_ns[record.target] = shift_ns
        bus = topic_name(record.target.partition(",")[0])
        self._say("begin", record, bus, record.first_ns + shift_ns)
        self._traffic(record, bus, shift_ns)
        self._say("end", record, bus, record.last_ns + shift_ns)

    def _traffic(self, record: VerdictRecord, bus: str, shift_ns: int) -> None:
        dialect = dialects.of_drive(record.target)
        setup = PortSetup((dialect,), offset=self._bytes.get(bus, 0))
        # Each claim begins afresh: what an earlier drive was told says nothing of this one.
        pipeline = Pipeline((dialect,), (self._log,), ports={bus: setup})
        pipeline.sequence = self._sequence
        for each in record.traffic:
            direction = Role.REQUEST if each.sent else Role.REPLY
            if each.can_id is not None:
                heard = direction if each.sent else Role.UNKNOWN
                pipeline.feed(CanFrame(each.t_ns + shift_ns, bus, each.can_id, each.data, heard, each.extended))
            else:
                pipeline.feed(Chunk(each.t_ns + shift_ns, bus, each.data, direction, True))
        pipeline.close()
        self._sequence = pipeline.sequence
        if bus in pipeline.ports:
            self._bytes[bus] = pipeline.ports[bus].bytes_in
        self._last_ns = max([self._last_ns, *(t.t_ns + shift_ns for t in record.traffic)])

    def _say(self, event: str, record: VerdictRecord, bus: str, t_ns: int) -> None:
        self._sequence += 1
        data: dict[str, Any] = {"event": event, "claim": record.id, "target": record.target, "bus": bus}
        if event == "begin":
            data |= {"statement": record.statement, "section": record.section, "certainty": record.certainty}
        else:
            told = {"reason": record.reason, "expected": record.expected, "got": record.got}
            data |= {"outcome": record.outcome} | {name: text for name, text in told.items() if text}
        self._last_ns = max(self._last_ns, t_ns)
        self._file.add_message(self._channel, self._sequence, self._last_ns, self._last_ns, msgspec.json.encode(data))

    def finish(self, metadata: dict[str, str], claim: dict[str, str] | None = None) -> None:
        if claim is not None:
            self._file.add_metadata(METADATA, claim)
        self._log.finish(metadata)


def _begun_ns(run: RunRecord) -> int:
    return checked_utc(calendar.timegm(time.strptime(run.started_at, "%Y-%m-%dT%H:%M:%SZ")) * 1_000_000_000)


def write_log(path: Path, records: Sequence[VerdictRecord], run: RunRecord, *, replace: bool = True) -> None:
    """Write the log of a run, under its name only when it is whole. Raises UsageError where it cannot be written."""
    ran = [r for r in records if r.outcome != Outcome.NOT_RUN]
    _write(path, ran, run, None, replace)


def _write(
    path: Path, records: Iterable[VerdictRecord], run: RunRecord, claim: dict[str, str] | None, replace: bool = True
) -> None:
    with whole(path, replace=replace) as stream:
        log = RunLog(McapFile(stream, profile=PROFILE, library=LIBRARY), _begun_ns(run))
        for record in records:
            log.add(record)
        log.finish(_metadata(run), claim)


def _metadata(run: RunRecord) -> dict[str, str]:
    return {
        "source": "servotap test: " + " ".join(run.targets),
        "dialect": ",".join(dict.fromkeys(t.partition("@")[0] for t in run.targets)),
        "on": " ".join(dict.fromkeys(run.on)),
        "time_source": "times of the run; emulated drives' claims laid one behind the other",
        "version": run.version,
        "seed": str(run.seed),
        "command": run.command,
    }


def write_failures(folder: Path, records: Sequence[VerdictRecord], run: RunRecord) -> list[Path]:
    """Write a small log of each refuted claim into a folder and return their names. Raises UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make {folder}: {error.strerror or error}") from None
    written = []
    for record in records:
        if record.refuted:
            place = dict(zip(run.targets, run.on, strict=True)).get(record.target, "")
            path = folder / (topic_name(f"{record.target}-{record.id}".replace("/", ".")) + ".mcap")
            claim = {
                "claim": record.id,
                "target": record.target,
                "on": place,
                "seed": str(run.seed),
                "allowed": ",".join(run.allowed),
                "key": record.key,
                "reason": record.reason,
                "expected": record.expected,
                "got": record.got,
                "parameters": msgspec.json.encode(record.parameters).decode(),
            }
            _write(path, [record], run, claim)
            written.append(path)
    return written
