"""The decoding process of a recording: it follows the spools of a folder and writes the log.

    python -m analyzer.live.recorder FOLDER [--feed FD]

It looks at the spools about sixty times a second. Once a second it flushes the log and stores a checkpoint. It ends when
it has read all spools up to the recording's end; then it removes the folder. `--feed` names the descriptor for the view's
snapshots. Standard input is the leash: when its other end closes, the process reads the rest and finishes the log, as after
SIGTERM.

Rules: it can be killed at any moment and started again. While the log cannot be written (a full disk) nothing is read, so
the spools keep it, and writing is retried until there is room. Other errors are one line on standard error.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import gc
import os
import stat
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from analyzer.diagnosis.running import Running
from analyzer.entries import Sink
from analyzer.errors import ServotapError, UsageError
from analyzer.live import config as settings
from analyzer.live.config import RecordingConfig
from analyzer.live.lock import DECODING, RUNNING, Lock
from analyzer.live.log_parts import LogParts, Wrap
from analyzer.live.reader_port import LEASH, Stop
from analyzer.live.recording import Recording
from analyzer.live.snapshot import SnapshotWriter
from analyzer.live.snapshot_sink import SnapshotSink
from analyzer.records import Event
from analyzer.sinks.mcap_sound import unreadable
from analyzer.system import own_process

#: Time between two looks at the spools, two flushes, two snapshots.
LOOK_NS = 15_000_000
#: What is in the log is not older than a second: this, and the wait for silent ports.
FLUSH_NS = 700_000_000
SNAPSHOT_NS = 100_000_000
#: Between two attempts to write on a full disk; how long it is tried once the end was asked for.
RETRY_S = 0.25
LAST_TRIES_NS = 2_000_000_000
#: Without leash and without anything new for this long, no reader is left.
QUIET_NS = 2_000_000_000
#: What the system says where there is no room.
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_FILES = ("*.raw", "*.taken", "checkpoint.*", "index.*", "recording.*", DECODING, RUNNING)


class Stalled(ServotapError):
    """The log cannot be written, and nothing more comes that could be waited for."""


class Damaged(ServotapError):
    """The log is not as it was written."""


class Recorder:
    """Follows the spools of a folder into its log.

    `feed_fd`: where snapshots go. `final`: the spools have no writer any more. `asked`: says from time to time why to end
    early, or an empty text; `say` takes messages for people.
    """

    def __init__(
        self,
        folder: Path,
        *,
        feed_fd: int | None = None,
        final: bool = False,
        asked: Callable[[], str] = lambda: "",
        say: Callable[[str], None] = lambda text: print(f"servotap record: {text}", file=sys.stderr, flush=True),
    ) -> None:
        self.folder = folder
        self.config = settings.load(folder)
        self._say = say
        self._asked = asked
        self._final = final
        self._read_back = final
        #: Bytes of the spools that were no record, at the end.
        self.damaged = 0
        self._ending = ""
        self._new_ns = 0
        self._snapshot_ns = 0
        self._feed: SnapshotSink | None = None
        self._writer: SnapshotWriter | None = None
        self._locks = self._taken()
        self.parts = LogParts(folder, self.config, wrap_of(self.config, say) if not final else None)
        if feed_fd is not None:
            self._writer = SnapshotWriter(feed_fd)
            self._feed = _feed_of(self.config)
        self._causes = Running()
        self._open: Recording | None = None
        self._open = self._opened(() if self._feed is None else (self._feed, self._causes))

    @property
    def recording(self) -> Recording:
        assert self._open is not None  # only while it is being opened
        return self._open

    def _opened(self, watch: Sequence[Sink]) -> Recording:
        """Open the recording, as soon as there is room for its beginning."""
        opened: list[Recording] = []
        self._patiently(
            lambda: opened.append(Recording(self.folder, self.config, self.parts, watch=watch, watched=self._causes.take)),
            note=lambda name, **about: opened[0].happened(name, **about),
        )
        return opened[0]

    def run(self, until: Callable[[], bool] = lambda: False) -> bool:
        """Follow until the end; the log is whole then and the folder gone. Raises Stalled where it cannot be written.

        Where `until` comes true before, all is left so that it can be gone on with, and False is returned.
        """
        recording, merger = self.recording, self.recording.merger
        flushed_ns = self._new_ns = time.monotonic_ns()
        self._flush()
        flushed_at = recording.parts.file.position
        while True:
            now_ns = time.monotonic_ns()
            if recording.take(merger.take(None if self._final else now_ns)):
                self._new_ns = now_ns
            recording.settle(merger.horizon_ns)
            if recording.parts.file.stalled:
                self._flush()
            if recording.rotation_due:
                self._patiently(self._restore_part)
                recording.rotate(self._patiently)
                flushed_ns, flushed_at = now_ns, recording.parts.file.position
            # Where much is to be caught up with, whole chunks go out by themselves: a checkpoint stands behind each.
            if now_ns - flushed_ns >= FLUSH_NS or recording.parts.file.position != flushed_at:
                flushed_ns = now_ns
                self._flush()
                flushed_at = recording.parts.file.position
            self._show(now_ns)
            if until():
                self._flush()
                return False
            if merger.drained:
                break
            self._final = self._final or self._is_over(now_ns)
            left_ns = LOOK_NS - (time.monotonic_ns() - now_ns)
            if left_ns > 0 and not self._final:
                time.sleep(left_ns / 1e9)
        self._finish()
        return True

    def _is_over(self, now_ns: int) -> bool:
        """Say whether no process writes the spools any more."""
        if self.recording.ended:
            return True
        self._ending = self._ending or self._asked()
        return bool(self._ending) and (self.recording.readers_ended or now_ns - self._new_ns > QUIET_NS)

    def _finish(self) -> None:
        recording = self.recording
        if not recording.ended:
            recording.happened("end", reason=self._ending or "the recording was killed; its log was repaired later")
            recording.ended = self._ending or "killed"
            recording.settle(recording.merger.horizon_ns)
        self.damaged = recording.damaged
        self._patiently(self._restore_part)
        recording.finish(self._patiently)
        self._show(time.monotonic_ns(), ended=True)
        trouble = self.parts.part_trouble()
        if not trouble and (self._read_back or self.parts.touched):
            trouble = unreadable(self.parts.path)
        if trouble:
            raise Damaged(f"{self.parts.path} is not as it was written: {trouble}; {self.folder} is kept")
        remove(self.folder)
        self.close()

    def _flush(self) -> None:
        self._patiently(self._restore_part)
        self._patiently(self.recording.flush)

    def _restore_part(self) -> None:
        done = self.parts.restore_part()
        if done:
            self._say(done)
            self.recording.happened("note", text=done)

    def close(self) -> None:
        """Give back what is held; without `run` having ended, all is left as it is."""
        self.recording.abandon()
        for lock in self._locks:
            lock.close()
        if self._writer is not None:
            self._writer.close()

    # --- writing on a full disk -----------------------------------------------------------------------------------

    def _patiently(self, step: Callable[[], None], note: Callable[..., None] | None = None) -> None:
        """Run a step again and again until it can write. Raises Stalled some time after the end was asked for."""
        begun_ns: int | None = None
        ending_ns: int | None = None
        while True:
            try:
                step()
                break
            except OSError as error:
                reason, full = error.strerror or str(error), error.errno in _FULL
                now_ns = time.monotonic_ns()
                if self._made_again():
                    continue
                if begun_ns is None:
                    begun_ns = now_ns
                    self._say(f"cannot write {self.parts.path}: {reason}; data is buffered next to it, retrying")
                    if self._feed is not None:
                        text = f"cannot write the log: {reason}; data is buffered next to it"
                        self._feed.happened(Event(self.config.utc_ns(now_ns), "", "note", {"text": text}), 0)
                # Asked here: while this waits, nothing else hears of the end.
                if ending_ns is None and (self._final or self._asked()):
                    ending_ns = now_ns
                if ending_ns is not None and now_ns - ending_ns > LAST_TRIES_NS:
                    raise Stalled(self._stalled(reason, full=full)) from None
            self._show(now_ns)
            time.sleep(RETRY_S)
        if begun_ns is not None:
            now_ns = time.monotonic_ns()
            self._say(f"{self.parts.path} is written again after {(now_ns - begun_ns) / 1e9:.1f} s")
            (note or self.recording.happened)("stalled", from_ns=begun_ns, to_ns=now_ns, reason=reason)

    def _made_again(self) -> bool:
        """Make the folder of the spools again where it was deleted; what its readers had opened can still be read."""
        if self._open is None or self._final or self.folder.is_dir():
            return False
        try:
            self.parts.store_again()
            self._lock_again()
        except OSError:
            return False
        text = f"{self.folder} was deleted and is made again"
        self._say(text)
        self.recording.happened("note", text=text)
        return True

    def _lock_again(self) -> None:
        for lock in self._locks:
            lock.close()
        self._locks = self._taken()

    def _taken(self) -> list[Lock]:
        locks = [Lock(self.folder, DECODING, taken=f"{self.folder}: another process decodes this recording")]
        return locks if self._final else [*locks, Lock(self.folder, RUNNING, shared=True)]

    def _stalled(self, reason: str, *, full: bool) -> str:
        path = self.parts.path
        if not self.folder.is_dir():
            return f"{self.folder} is gone, and what it held is lost; servotap recover {path} repairs what {path} has"
        remedy = "Free some space" if full else f"Mend that, or move it with {self.folder.name} to another disk"
        return f"{path} cannot be written: {reason}. {remedy}; then servotap recover {path} goes on where it stopped"

    # --- for viewers -----------------------------------------------------------------------------------------------

    def _show(self, now_ns: int, *, ended: bool = False) -> None:
        if self._feed is None or self._writer is None or self._open is None:
            return
        if now_ns - self._snapshot_ns < SNAPSHOT_NS and not ended:
            return
        self._snapshot_ns = now_ns
        t_ns = self.config.utc_ns(now_ns)
        dialects = list({d.name: d for bus in self._open.buses.values() for d in bus.dialects}.values())
        for line in self._causes.end(now_ns, dialects) if ended else self._causes.look(now_ns, dialects):
            self._feed.event(t_ns, "", "cause", line.strip())
        self._feed.causes = self._causes.causes
        self._feed.log = str(self.parts.path)
        self._feed.log_bytes = self.parts.file.position
        self._feed.behind_ns = self.recording.merger.behind_ns(now_ns)
        self._feed.lost = {name: sum(bus.lost.values()) for name, bus in self.recording.buses.items()}
        self._writer.offer(self._feed.snapshot(t_ns, ended=ended))


def _feed_of(config: RecordingConfig) -> SnapshotSink:
    byte_ns = {p.bus: p.byte_ns for p in config.ports if p.byte_ns and p.kind == "serial"}
    bit_ns = {p.bus: 1_000_000_000 // p.speed for p in config.ports if p.kind == "can" and p.speed}
    return SnapshotSink(byte_ns=byte_ns, bit_ns=bit_ns)


def wrap_of(config: RecordingConfig, say: Callable[[str], None]) -> Wrap | None:
    """Return what is put between the log and its file: nothing, or a live view over Foxglove's WebSocket."""
    if not config.foxglove:
        return None
    from analyzer.sinks.foxglove_live import FoxgloveServer, read_place

    try:
        server = FoxgloveServer(read_place(config.foxglove))
    except UsageError as error:
        # Watching is not worth a recording.
        say(f"{error}; the recording goes on without it")
        return None
    say(f"foxglove: open {server.address} there")
    return server.beside


def remove(folder: Path) -> None:
    """Delete a folder of spools; what is not of a recording or cannot be deleted stays, and the folder with it."""
    for path in (path for pattern in _FILES for path in folder.glob(pattern)):
        with contextlib.suppress(OSError):
            path.unlink()
    with contextlib.suppress(OSError):
        folder.rmdir()


def main(words: Sequence[str] | None = None) -> int:
    """Run the process; return its exit status: `config.WHOLE`, or 1 when something is left to be mended."""
    parser = argparse.ArgumentParser(prog="analyzer.live.recorder", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("folder", type=Path, help="the folder of the spools")
    parser.add_argument("--feed", type=int, metavar="FD", help="descriptor for snapshots")
    arguments = parser.parse_args(words)
    stop = Stop("the process that had started the recording died")
    stop.on_signals()
    # A terminal or a file does not end when the parent dies.
    if stat.S_ISSOCK(mode := os.fstat(LEASH).st_mode) or stat.S_ISFIFO(mode):
        stop.on_leash()
    try:
        recorder = Recorder(arguments.folder, feed_fd=arguments.feed, asked=lambda: stop.asked)
        # What is loaded by now stays; the collector need not look at it while records come and go.
        gc.collect()
        gc.freeze()
        recorder.run()
    except ServotapError as error:
        print(f"servotap record: {error}", file=sys.stderr)
        return 1
    return settings.WHOLE


if __name__ == "__main__":
    own_process.take()
    sys.exit(main())
