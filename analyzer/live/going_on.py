"""Where a recording stands, into its checkpoint and back: so that a process goes on where another was killed."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

from analyzer.events import PORT
from analyzer.live import checkpoint
from analyzer.live.checkpoint import Checkpoint, SpoolState
from analyzer.pipeline import PortSetup
from analyzer.records import Chunk, Event
from analyzer.setups import Setups

if TYPE_CHECKING:
    from analyzer.live.recording import Recording


def save_beginning(recording: Recording) -> None:
    """Note which part is about to be begun, before there is anything of it."""
    parts = recording.parts
    Checkpoint(part=parts.number, path=parts.path.name, position=0).save(recording.folder)


def save(recording: Recording) -> None:
    """Note where a recording stands, right after its log was flushed. Raises OSError with what was noted before in place."""
    buses = {}
    for name, bus in recording.buses.items():
        state = buses[name] = bus.state()
        port = recording.pipeline.ports.get(name)
        if port is not None and port.framer is not None:
            state.pending, state.pending_ns = port.framer.pending, bus.last_ns
    Checkpoint(
        **recording.parts.state(),
        log=recording.log.state(),
        spools={
            stem: SpoolState(
                segment=spool.position[0],
                place=spool.position[1],
                expected=recording.follows[stem].expected,
                ended=recording.follows[stem].ended,
            )
            for stem, spool in recording.spools.items()
        },
        buses=buses,
        counts=recording.tally.state(),
        clock_ns=recording.clock_ns,
        sequence=recording.pipeline.sequence,
        digest=recording.table.digest,
        decoding=checkpoint.dump_state(recording.pipeline.state(), recording.table),
        ended=recording.ended,
        drift_ns=recording.drift_ns,
        moved=(recording.moved, recording.moved_ns),
    ).save(recording.folder)


def go_on(recording: Recording, start: Checkpoint) -> None:
    """Put a recording where another stood, whose log it has opened."""
    recording.log.restore(start.log, recording.parts.file)
    for name, state in start.buses.items():
        bus = recording.buses.get(name)
        if bus is not None:
            bus.restore(state, recording.known)
            if state.byte_ns is not None:
                recording.set_speed(bus, state.speed, state.byte_ns)
                recording.log.learn(name, bus.load)
    for stem, spool in start.spools.items():
        if stem in recording.follows:
            recording.follows[stem].expected = spool.expected
            recording.follows[stem].ended = spool.ended
    recording.tally.restore(start.counts)
    recording.clock_ns = start.clock_ns
    recording.ended, recording.drift_ns = start.ended, start.drift_ns
    recording.moved, recording.moved_ns = start.moved
    recording.declare()
    setups = _setups(recording)
    if start.digest == recording.table.digest:
        with contextlib.suppress(ValueError, KeyError):
            recording.pipeline.restore(checkpoint.load_state(start.decoding, recording.table), setups)
            return
    _go_on_by_bytes(recording, start, setups)


def _setups(recording: Recording) -> dict[str, PortSetup]:
    asked = Setups(recording.known)
    found = {name: asked(Event(0, name, PORT, bus.setup())) for name, bus in recording.buses.items()}
    return {name: setup for name, setup in found.items() if setup is not None}


def _go_on_by_bytes(recording: Recording, start: Checkpoint, setups: Mapping[str, PortSetup]) -> None:
    """Go on without the state of decoding: half frames anew from their bytes, with no request open."""
    pipeline = recording.pipeline
    pipeline.ports.clear()
    pipeline.sequence = start.sequence
    for name, setup in setups.items():
        state = start.buses.get(name)
        if state is None:
            continue
        begin = state.offset - len(state.pending)
        pipeline.set_up(name, PortSetup(setup.dialects, setup.byte_ns, begin))
        if state.pending:
            recording.decode(recording.buses[name], Chunk(state.pending_ns, name, state.pending))
    recording.happened("note", text="another version of servotap goes on with this recording: open requests were given up")
