"""A recording under way: records of the spools in, in order of time; the log out.

    record -> (held back until the dialect is known) -> pipeline -> log
           `-> /<bus>/raw

Rules: the output depends on the records alone, never on when they are processed. So a live log equals the log of `decode`
over its raw bytes. Times never go back. An error of decoding costs no byte. Writing can fail (a full disk): `flush`,
`rotate` and `finish` raise OSError with nothing lost and may be called again.

Not known here: processes, clocks, when to flush.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from analyzer import dialects as registry
from analyzer import events
from analyzer.detect import Choice
from analyzer.devices import described
from analyzer.entries import Sink
from analyzer.errors import UnreadableError
from analyzer.framer import SILENCE_NS
from analyzer.live import checkpoint
from analyzer.live.bus import Bus, Follow, HeldRecords, buses_of
from analyzer.live.checkpoint import Checkpoint, CountsState, LogState, SpoolState
from analyzer.live.clock import LogClock
from analyzer.live.config import CONTROL, RecordingConfig
from analyzer.live.counts import RecordingCounts
from analyzer.live.log_parts import LogParts
from analyzer.live.noted import event_values
from analyzer.live.spool import NEVER_NS, Record, RecordKind
from analyzer.live.spool_merge import Merger, Spool
from analyzer.pipeline import Pipeline
from analyzer.port import Options, PortSetup, Setups
from analyzer.records import CanFrame, Chunk, Comment, Event
from analyzer.sinks.object_table import Table
from analyzer.sinks.recording_log import RecordingLog

#: A part is rotated in the midst of a frame when there was no better place for this long.
SEAM_NS = 1_000_000_000


class Recording:
    """One recording: begun, or resumed where its folder holds a checkpoint.

    `parts`: the files of its log. `watch`: further sinks. `watched`: takes what came on a bus before it is decoded, with the
    offset of its first byte.
    """

    def __init__(
        self,
        folder: Path,
        config: RecordingConfig,
        parts: LogParts,
        *,
        watch: Sequence[Sink] = (),
        watched: Callable[[Chunk | CanFrame, int], None] = lambda item, offset: None,
    ) -> None:
        self.folder = folder
        self.config = config
        self.parts = parts
        self._watched = watched
        #: Files that describe other devices; what a reader should know of them stands in the notes already.
        self.device_files = described(config.devices, lambda text: None)
        devices = [dialect for file in self.device_files for dialect in file.dialects]
        known = registry.readable_by_name(devices, config.model)
        self.known = known
        self.table = Table(list(known.values()))
        self.buses = buses_of(config, known, devices)
        self.follows: dict[str, Follow] = {CONTROL: Follow(None, None)}
        for port in config.ports:
            self.follows[port.stem] = Follow(self.buses[port.bus], port)
        self._clock = LogClock(config.anchor_monotonic_ns, config.anchor_utc_ns)
        #: Why the recording ended, empty until then.
        self.ended = ""
        self.drift_ns = 0
        self._held = HeldRecords(self._change)
        self._due_ns: int | None = None
        #: Events of this process that wait for a place between records.
        self._own: list[tuple[str, dict[str, Any]]] = []
        self.counts = RecordingCounts(self._junk)
        speeds = {bus.name: bus.load for bus in self.buses.values()}
        found = checkpoint.load(folder)
        start = found if found is not None and found.position else None
        self._number = 0 if found is None else found.number
        #: The segment of each spool that the checkpoint before the newest one needs.
        self._needed = {} if start is None else {stem: s.segment for stem, s in start.spools.items()}
        places = {} if start is None else {stem: (s.segment, s.place) for stem, s in start.spools.items()}
        self.merger = Merger(folder, list(self.follows), places)
        self.spools = {spool.stem: spool for spool in self.merger.spools}
        if start is None:
            file = parts.begin(1, self._save_beginning, mine=found is not None)
        else:
            file = parts.resume(start)
        self.log = RecordingLog(file, speeds=speeds)
        sinks: tuple[Sink, ...] = (self.log, self.counts, *watch)
        options = Options(late_ns=config.late_ns, groups=frozenset(config.groups))
        drives = [dialect for dialect in known.values() if dialect.of_drives]
        self.pipeline = Pipeline(drives, sinks, options, on_setup=Setups(known))
        if start is None:
            self._open_part()
            return
        try:
            self._resume(start)
        # What it holds may fit each other or not.
        except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
            raise UnreadableError(f"the checkpoint in {folder} is none of this recording: {error!r}") from None

    # --- parts of the log -----------------------------------------------------------------------------------------

    def _open_part(self) -> None:
        """Say at the beginning of a part all that is needed to read it by itself."""
        self.declare()
        part, previous = self.parts.number, self.parts.previous
        self._feed_event("", "part", {"part": part, **({"previous": previous} if previous else {}), **self._choices()})
        for bus in self.buses.values():
            self._feed_event(bus.name, events.PORT, bus.setup())
        self.log.describe(self.parts.METADATA, self._about())

    def declare(self) -> None:
        """Declare the raw topics. Of a CAN bus the decoded frames are all that came, so it needs none beside them."""
        for bus in self.buses.values():
            if bus.kind == "serial" or self.config.raw_only:
                self.log.declare(bus.name, bus.kind)

    def _choices(self) -> dict[str, Any]:
        """Return the options of decoding, for decoding the log again."""
        config = self.config
        values: dict[str, Any] = {"recording": self.parts.recording, "late": config.late_ns / 1e9}
        if config.model:
            values["model"] = config.model
        if config.groups:
            values["groups"] = list(config.groups)
        return values

    def _about(self) -> dict[str, str]:
        values = {**self.parts.about(), **self.counts.about(), "drift_ns": str(self.drift_ns)}
        used = {d.name: self.known[d.name] for bus in self.buses.values() for d in bus.dialects}
        values["dialect"] = ",".join(used)
        values["manual"] = "; ".join(d.manual for d in used.values())
        values["dialect_reason"] = "; ".join(f"{bus.name}: {bus.reason}" for bus in self.buses.values() if bus.reason)
        for bus in self.buses.values():
            values |= bus.about()
        for file in self.device_files:
            values |= file.about
        notes = [f"{bus.name}: {note}" for bus in self.buses.values() for note in bus.notes]
        notes += list(self.config.notes)
        notes += self._clock.notes
        if notes:
            values["notes"] = "; ".join(notes)
        return values

    @property
    def rotation_due(self) -> bool:
        """It is time for another part, and here no frame is cut in two (or that was waited for long enough)."""
        if not self.parts.full(self._clock.now_ns) or not self.counts.part_bytes:
            return False
        if self._due_ns is None:
            self._due_ns = self._clock.now_ns
        ports = self.pipeline.ports.values()
        return self._clock.now_ns - self._due_ns > SEAM_NS or all(p.framer is None or p.framer.between for p in ports)

    def rotate(self, patiently: Callable[[Callable[[], None]], None]) -> None:
        """End this part and begin another. `patiently` runs a step again until it succeeds."""
        self.log.tick(NEVER_NS)
        patiently(self.flush)
        metadata = {**self._about(), "next": self.parts.next_name}
        patiently(lambda: self.log.finish(metadata))
        patiently(self.parts.sync)
        patiently(lambda: self.log.go_over(self.parts.begin(self.parts.number + 1)))
        self.counts.begin_part()
        self._due_ns = None
        patiently(self._begun_part())
        # Twice: then neither checkpoint needs the part before.
        patiently(self.flush)
        patiently(self.flush)
        for text in self.parts.drop_old():
            self.happened("note", text=text)

    def _begun_part(self) -> Callable[[], None]:
        """Return the step that opens a part; its events are fed once, though it may be tried again."""
        fed = False

        def step() -> None:
            nonlocal fed
            if not fed:
                fed = True
                self._open_part()
            else:
                self.log.describe(self.parts.METADATA, self._about())

        return step

    def flush(self) -> None:
        """Bring everything so far into the log and note where it stands. Raises OSError; then call it again."""
        self.log.tick(self._clock.now_ns)
        self.log.flush()
        self._save()
        for stem, spool in self.spools.items():
            spool.reader.drop_before(self._needed.get(stem, 0))
            self._needed[stem] = spool.position[0]

    def finish(self, patiently: Callable[[Callable[[], None]], None]) -> None:
        """Make the log whole: nothing more comes."""
        self._release(NEVER_NS, final=True)
        for spool in self.spools.values():
            self._note_damage(spool)
        self.pipeline.close()
        patiently(self.log.flush)
        # Even now the disk may have been full.
        self._feed_own()
        metadata = {**self._about(), "ended": self.ended or "broke off"}
        patiently(lambda: self.log.finish(metadata))
        patiently(self.parts.sync)
        self.merger.close()
        self.parts.close()

    def abandon(self) -> None:
        """Stop writing and leave all as it is."""
        self.log.abandon()
        self.merger.close()

    @property
    def readers_ended(self) -> bool:
        """Every reader has said that it ends."""
        return all(follow.ended for follow in self.follows.values() if follow.bus is not None)

    # --- checkpoints ----------------------------------------------------------------------------------------------

    def _save_beginning(self) -> None:
        """Save which part is about to begin, before its file exists."""
        parts = self.parts
        Checkpoint(number=self._number, part=parts.number, path=parts.path.name, position=0).save(self.folder)

    def _save(self) -> None:
        """Save the checkpoint, right after the log was flushed. Raises OSError with the checkpoint before still there."""
        buses = {}
        for name, bus in self.buses.items():
            state = buses[name] = bus.state()
            port = self.pipeline.ports.get(name)
            if port is not None and port.framer is not None:
                state.pending, state.pending_ns = port.framer.pending, bus.last_ns
        Checkpoint(
            number=self._number + 1,
            **self.parts.state(),
            log=msgspec.convert(self.log.state(), LogState),
            spools={
                stem: SpoolState(
                    segment=spool.position[0],
                    place=spool.position[1],
                    expected=self.follows[stem].expected,
                    ended=self.follows[stem].ended,
                )
                for stem, spool in self.spools.items()
            },
            buses=buses,
            counts=msgspec.convert(self.counts.state(), CountsState),
            clock_ns=self._clock.now_ns,
            sequence=self.pipeline.sequence,
            digest=self.table.digest,
            decoding=checkpoint.dump_state(self.pipeline.state(), self.table),
            ended=self.ended,
            drift_ns=self.drift_ns,
            moved=(self._clock.moved, self._clock.moved_ns),
        ).save(self.folder)
        self._number += 1

    def _resume(self, start: Checkpoint) -> None:
        """Resume from a checkpoint; the log is open already."""
        self.log.restore(msgspec.to_builtins(start.log), self.parts.file)
        for name, state in start.buses.items():
            bus = self.buses.get(name)
            if bus is not None:
                bus.restore(state, self.known)
                if state.byte_ns is not None:
                    self.set_speed(bus, state.speed, state.byte_ns)
                    self.log.learn(name, bus.load)
        for stem, spool in start.spools.items():
            if stem in self.follows:
                self.follows[stem].expected = spool.expected
                self.follows[stem].ended = spool.ended
        self.counts.restore(msgspec.to_builtins(start.counts))
        self._clock.restore(start.clock_ns, start.moved)
        self.ended, self.drift_ns = start.ended, start.drift_ns
        self.declare()
        setups = self._port_setups()
        if start.digest == self.table.digest:
            with contextlib.suppress(ValueError, KeyError):
                self.pipeline.restore(checkpoint.load_state(start.decoding, self.table), setups)
                return
        self._resume_from_bytes(start, setups)

    def _port_setups(self) -> dict[str, PortSetup]:
        asked = Setups(self.known)
        found = {name: asked(Event(0, name, events.PORT, bus.setup())) for name, bus in self.buses.items()}
        return {name: setup for name, setup in found.items() if setup is not None}

    def _resume_from_bytes(self, start: Checkpoint, setups: Mapping[str, PortSetup]) -> None:
        """Resume without the decoder's state: half frames are decoded again from their bytes, and no request is open."""
        pipeline = self.pipeline
        pipeline.ports.clear()
        pipeline.sequence = start.sequence
        for name, setup in setups.items():
            state = start.buses.get(name)
            if state is None:
                continue
            begin = state.offset - len(state.pending)
            pipeline.set_up(name, PortSetup(setup.dialects, setup.byte_ns, begin, setup.listed))
            if state.pending:
                self.decode(self.buses[name], Chunk(state.pending_ns, name, state.pending))
        self.happened("note", text="another version of servotap resumed this recording: open requests were given up")

    # --- records --------------------------------------------------------------------------------------------------

    def take(self, records: Iterable[tuple[Spool, Record]]) -> int:
        """Deal with records; return how many there were."""
        count = 0
        for spool, record in records:
            count += 1
            self._take(spool, record)
        return count

    def _take(self, spool: Spool, record: Record) -> None:
        if self._held.active:
            self._hold(spool, record)
            return
        kind = record.kind
        follow = self.follows[spool.stem]
        if not follow.stores(record):
            spool.reader.damaged += len(record.data)
            return
        if kind == RecordKind.DATA or kind == RecordKind.CAN:
            bus = follow.bus
            assert bus is not None  # the spool of the recording itself has no traffic
            if bus.detection is not None and not bus.detection.dialects and not self.config.raw_only:
                self._held.begin(bus, record)
                self._hold(spool, record)
                return
        if follow.expected is not None and record.before > follow.expected:
            self._missing(follow, record)
        if kind == RecordKind.DATA:
            self._data(follow, record)
        elif kind == RecordKind.CAN:
            self._can(follow, record)
        elif kind == RecordKind.IDLE:
            self._idle(follow, self._clock.at(record.t_ns))
        else:
            self._event(follow, record)
        follow.expected = record.before + (len(record.data) if kind == RecordKind.DATA else kind == RecordKind.CAN)
        self._note_damage(spool)
        spool.position = record.segment, record.end

    def _note_damage(self, spool: Spool) -> None:
        """Note what was no record in a spool, and has not been noted."""
        damaged = spool.reader.damaged - spool.damaged
        if damaged:
            bus = self.follows[spool.stem].bus
            self._own.append((bus.name if bus else "", {"event": "damaged", "bytes": damaged}))
            spool.damaged = spool.reader.damaged

    @property
    def damaged(self) -> int:
        """Bytes of the spools that were no record and are passed."""
        return sum(spool.reader.damaged for spool in self.spools.values())

    def _data(self, follow: Follow, record: Record) -> None:
        bus = follow.bus
        assert bus is not None  # the spool of the recording itself has none
        t_ns, data = self._clock.at(record.t_ns), record.data
        chunk = Chunk(t_ns, bus.name, data, follow.role)
        offset = bus.offset
        size = len(data)
        bus.offset = offset + size
        bus.last_ns = t_ns
        bus.sounded = True
        if not self.config.raw_only:
            if bus.detection is not None:
                bus.detection.add(chunk)
            self.decode(bus, chunk)
        self.counts.bytes += size
        self.log.raw(chunk, offset, t_ns - size * follow.byte_ns)

    def _can(self, follow: Follow, record: Record) -> None:
        bus = follow.bus
        assert bus is not None  # as above
        t_ns = self._clock.at(record.t_ns)
        frame = bus.can_frame(record, t_ns)
        offset = bus.offset
        bus.offset = offset + len(frame.data)
        bus.last_ns = t_ns
        self.counts.bytes += len(frame.data)
        if self.config.raw_only:
            self.log.raw_can(frame, offset)
            return
        if bus.detection is not None:
            bus.detection.add(frame)
        self.decode(bus, frame)

    def decode(self, bus: Bus, item: Chunk | CanFrame) -> None:
        self._watched(item, bus.offset - len(item.data))
        try:
            self.pipeline.feed(item)
        # Nothing that comes over a wire may end a recording; that it happened stands in the log.
        except Exception as error:
            port = self.pipeline.ports.get(bus.name)
            if port is not None:
                port.bytes_in = bus.offset
                port.renew()
            text = f"{type(error).__name__}: {error} at byte {bus.offset - len(item.data)}: {item.data[:64].hex(' ').upper()}"
            self._own.append((bus.name, {"event": "fault", "text": text}))

    def _idle(self, follow: Follow, t_ns: int) -> None:
        """End what waits on a bus that was quiet long enough, and note that so that it can be done again."""
        bus = follow.bus
        if bus is None or bus.kind != "serial" or not bus.sounded or t_ns - bus.last_ns <= SILENCE_NS:
            return
        bus.sounded = False
        if not self.config.raw_only:
            self.pipeline.silence(bus.name)
        self.log.silence(t_ns, bus.name, bus.offset)

    def _missing(self, follow: Follow, record: Record) -> None:
        """Tell what its reader counted and did not store, unless this is the record that says so."""
        bus = follow.bus
        if bus is None or (record.kind == RecordKind.EVENT and record.event.get("event") == "dropped"):
            return
        unit = "frames" if bus.kind == "can" else "bytes"
        missing = record.before - (follow.expected or 0)
        bus.lose(unit, missing)
        self._clock.at(record.t_ns)
        self._feed_event(bus.name, "missing", {unit: missing})

    # --- events ---------------------------------------------------------------------------------------------------

    def _event(self, follow: Follow, record: Record) -> None:
        noted = record.event
        name = str(noted.get("event", ""))
        t_ns = self._clock.at(record.t_ns)
        bus = follow.bus
        if bus is None and name == "mark":
            self.pipeline.feed(Comment(t_ns, "", str(noted.get("text", ""))))
            return
        values = event_values(noted, self.config.utc_ns)
        if bus is not None:
            follow.ended = name == "closed"
            for note in values.get("notes", ()):
                bus.note(note)
            if name == "note":
                bus.note(str(values.get("text", "")))
            if name in ("dropped", "kernel_dropped"):
                for unit in ("bytes", "frames"):
                    if isinstance(values.get(unit), int):
                        bus.lose(unit, values[unit])
            if name == events.SPEED:
                values = self._new_speed(bus, values)
            if events.KINDS.get(name, events.KINDS["end"]).cuts:
                bus.sounded = False
        elif name == "clock_drift":
            self.drift_ns = int(noted.get("offset_ns", 0))
        elif name == "end":
            self.ended = str(noted.get("reason", "")) or "ended"
        self._feed_event("" if bus is None else bus.name, name, values)

    def set_speed(self, bus: Bus, speed: int | None, byte_ns: int) -> None:
        """Take the speed that a bus has from here on, with all its ports."""
        bus.speed, bus.byte_ns = speed, byte_ns
        for follow in self.follows.values():
            if follow.bus is bus:
                follow.byte_ns = byte_ns

    def _new_speed(self, bus: Bus, values: dict[str, Any]) -> dict[str, Any]:
        """Take over the speed that a line has from here on; return all that is known of it."""
        speed, byte_ns = values.get("speed"), values.get("byte_ns")
        self.set_speed(
            bus, speed if isinstance(speed, int) else bus.speed, byte_ns if isinstance(byte_ns, int) else bus.byte_ns
        )
        return {**bus.setup(), **values}

    def _feed_event(self, bus: str, name: str, values: Mapping[str, Any]) -> None:
        self.pipeline.feed(Event(self._clock.now_ns, bus, name, dict(values)))

    def happened(self, name: str, **noted: Any) -> None:
        """Note an event of this process itself, as a reader would; it goes into the log at the next `settle`."""
        self._own.append(("", {"event": name, **noted}))

    def settle(self, horizon_ns: int) -> None:
        """Do what waits for a place between records, everything before `horizon_ns` (monotonic) being dealt with."""
        self._release(horizon_ns)
        if not self._held.active:
            self._feed_own()
            self._held.look_again(self.buses.values(), self._clock.monotonic_ns)

    def _feed_own(self) -> None:
        own, self._own = self._own, []
        for bus, noted in own:
            self._feed_event(bus, noted["event"], event_values(noted, self.config.utc_ns))

    # --- dialects -------------------------------------------------------------------------------------------------

    def _hold(self, spool: Spool, record: Record) -> None:
        """Keep a record back, for the dialect of a bus is not known yet; deal with all when it is."""
        self._held.add(spool, record, self.follows[spool.stem].bus)
        self._release(record.t_ns)

    def _release(self, t_ns: int, *, final: bool = False) -> None:
        # What was held back of one bus may be the first that comes of another.
        while self._held.active:
            held = self._held.release(t_ns, final=final)
            if not held:
                return
            for spool, record in held:
                self._take(spool, record)

    def _change(self, bus: Bus, choice: Choice, t_ns: int) -> None:
        self._clock.at(t_ns)
        bus.dialects, bus.reason = choice.dialects, choice.reason
        self._feed_event(bus.name, events.DIALECT, {**bus.setup(), "reason": choice.reason})

    def _junk(self, port: str, size: int) -> None:
        bus = self.buses.get(port)
        if bus is not None and bus.detection is not None:
            bus.detection.junk(size)
