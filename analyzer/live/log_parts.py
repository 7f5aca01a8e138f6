"""The files of a recording's log: begun, resumed, ended, and deleted when there are too many.

Without rotation the log is one file. With rotation it has parts (`sources.recording_parts`), each a complete log by itself.
The index for a part's summary stands in the folder of the spools until the summary is written.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import msgspec

from analyzer import __version__
from analyzer.errors import UnreadableError, UsageError
from analyzer.live.checkpoint import Checkpoint, FileState
from analyzer.live.config import RecordingConfig
from analyzer.sinks.mcap_file import LogFile, McapFile
from analyzer.sinks.mcap_index import FileIndex, WholeWrites
from analyzer.sinks.mcap_log import LIBRARY, PROFILE
from analyzer.sources import recording_parts
from analyzer.sources.times import iso
from analyzer.values import counted

#: Where only the sum of all parts is bounded, a part has this share of it, and at least so many bytes.
_SHARE = 10
_LEAST_PART = 1 << 20
_SPOOL = ".spool"
TIME_SOURCE = "clock of the host: when the last byte had arrived; monotonic, anchored to UTC once at the start"

#: Puts something between a log and its file, such as a live view of it; called for each part.
Wrap = Callable[[McapFile], LogFile]


def log_of(folder: Path, config: RecordingConfig) -> Path:
    """Return the log of a folder of spools: it is next to the folder, even if both were moved."""
    return folder.with_name(folder.name[: -len(_SPOOL)]) if folder.name.endswith(_SPOOL) else Path(config.log)


class LogParts:
    """The parts of one recording. `number`, `path`: of the part that is being written."""

    METADATA = recording_parts.METADATA

    def __init__(self, folder: Path, config: RecordingConfig, wrap: Wrap | None = None) -> None:
        self._folder = folder
        self._config = config
        self._wrap = wrap
        self.log = log_of(folder, config)
        self.rotate_bytes = config.rotate_bytes
        if config.max_total and not (config.rotate_bytes or config.rotate_ns):
            self.rotate_bytes = max(config.max_total // _SHARE, _LEAST_PART)
        self.rotating = bool(self.rotate_bytes or config.rotate_ns)
        #: The same for all parts, also after a kill.
        self.recording = f"{config.anchor_utc_ns:016x}-{config.anchor_monotonic_ns:016x}"
        self.number = 1
        self.path = self.log
        self.previous = ""
        self._begun_ns: int | None = None
        self._stream: WholeWrites | None = None
        #: Something else may have written to the log.
        self.touched = False
        self._closed: os.stat_result | None = None
        self._index: FileIndex | None = None
        self.file: McapFile

    # --- begin, go on, end ----------------------------------------------------------------------------------------

    def begin(self, number: int, before: Callable[[], None] | None = None, *, mine: bool = False) -> LogFile:
        """Begin a part. `before` is called when it is known which it will be, and nothing is there yet.

        `mine`: what stands under the name was begun by a process that was killed. Without `before` the next number is
        taken where another file has that name. Raises OSError with nothing left, UsageError where the first
        one exists.
        """
        previous = self.path.name if before is None else ""
        path = self._path(number)
        if before is None:
            # A link that leads nowhere has the name, too.
            while os.path.lexists(path):
                number += 1
                path = self._path(number)
        elif os.path.lexists(path) and not mine:
            raise UsageError(f"{path} exists, and a recording replaces no file")
        was = self.number, self.path
        self.close()
        self.number, self.path = number, path
        if before is not None:
            before()
        stream: IO[bytes] | None = None
        try:
            stream = self._create(path, mine=mine)
            index = FileIndex(self._index_path(number))
            whole = WholeWrites(stream)
            file = McapFile(whole, profile=PROFILE, library=LIBRARY, index=index, patient=True)
        except OSError:
            if stream is not None:
                stream.close()
                path.unlink(missing_ok=True)
            self.number, self.path = was
            raise
        self._stream, self._index, self.file = whole, index, file
        self.previous = previous
        self._begun_ns = None
        return self._wrap(file) if self._wrap is not None else file

    def path_of(self, start: Checkpoint) -> Path:
        """Return where the part of a checkpoint is: it was renamed with the log, or has the name that it had."""
        was = Path(self._config.log).stem
        renamed = self.log.with_name(self.log.stem + start.path.removeprefix(was))
        return renamed if start.path.startswith(was) and os.path.lexists(renamed) else self.log.with_name(start.path)

    def resume(self, start: Checkpoint) -> LogFile:
        """Resume the part of a checkpoint behind its last flush. Raises UnreadableError if it is missing."""
        self.number = start.part
        self.path = self.path_of(start)
        self.previous = start.previous
        try:
            size = self.path.stat().st_size
            if size < start.position:
                raise UnreadableError(
                    f"{self.path} has {counted(size, 'byte')}, but {start.position} had been written: it was cut or replaced"
                )
            if not self._is_own(self.path):
                raise UnreadableError(f"{self.path} is not the log of this recording, or is damaged at its beginning")
            self._drop_later()
            stream = open(self.path, "r+b", buffering=0)  # noqa: SIM115
            self._stream = WholeWrites(stream, start.position)
            self._index = FileIndex(self._index_path(self.number), start.index_length, start.index_crc)
        except ValueError as error:
            raise UnreadableError(str(error)) from None
        except OSError as error:
            raise UnreadableError(f"{self.path} cannot be resumed: {error.strerror or error}") from None
        self.file = McapFile.resume(self._stream, msgspec.to_builtins(start.file), self._index, patient=True)
        self._begun_ns = start.begun_ns
        return self._wrap(self.file) if self._wrap is not None else self.file

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint says of the part, right after a flush."""
        assert self._index is not None  # a part was begun
        return {
            "part": self.number,
            "path": self.path.name,
            "previous": self.previous,
            "begun_ns": self._begun_ns,
            "position": self.file.position,
            "index_length": self._index.length,
            "index_crc": self._index.crc,
            "file": msgspec.convert(self.file.state(), FileState),
        }

    def sync(self) -> None:
        if self._stream is not None:
            self._stream.sync()

    def _create(self, path: Path, *, mine: bool = False) -> IO[bytes]:
        """Make a file that is not there yet; `mine`: or is replaced. Raises OSError."""
        if path.is_symlink():
            raise OSError(errno.ELOOP, "a link stands under its name")
        # Read, too: what stands there is looked at when a process goes on with it.
        stream = open(path, "w+b" if mine else "x+b", buffering=0)  # noqa: SIM115
        if self._config.mode is not None:
            path.chmod(self._config.mode)
        return stream

    def restore_part(self) -> str:
        """See that the part stands under its name. Where it was deleted, moved or replaced, write all of it anew.

        Returns what was done, or nothing. Raises OSError; then it may be called again.
        """
        stream = self._stream
        if stream is None:
            return ""
        was = self.path
        try:
            if os.path.samestat(stream.stat(), os.lstat(was)):
                return ""
            path = self._other_name()
        except FileNotFoundError:
            path = was
        copy = self._create(path)
        try:
            stream.go_over(copy)
        except OSError:
            copy.close()
            path.unlink(missing_ok=True)
            raise
        self.path = path
        what = "deleted or moved" if path == was else "replaced by something else"
        return f"{was} was {what} while it was being recorded: all of the recording is written anew, to {path}"

    def _other_name(self) -> Path:
        number = 1
        while os.path.lexists(path := self.path.with_name(f"{self.path.stem}-recorded-{number}{self.path.suffix}")):
            number += 1
        return path

    def part_trouble(self) -> str:
        """Say what is wrong with the file of the part, which was finished and closed; nothing if nothing is."""
        try:
            found = os.lstat(self.path)
        except OSError as error:
            return error.strerror or str(error)
        if self._closed is None or not os.path.samestat(found, self._closed):
            return "another file has its name"
        if found.st_size != self.file.position:
            return f"it has {counted(found.st_size, 'byte')}, and {self.file.position} were written"
        return ""

    def store_again(self) -> None:
        """Make the folder of the spools again, as it was deleted. Raises OSError."""
        self._folder.mkdir(exist_ok=True)
        self._config.save(self._folder)
        if self._index is not None:
            self._index.store_again()

    def close(self) -> None:
        if self._stream is not None:
            self._closed = self._stream.stat()
            self.touched = self.touched or self._stream.touched
            self._stream.close()
        if self._index is not None:
            self._index.close()
        self._stream = self._index = None

    # --- rotation -------------------------------------------------------------------------------------------------

    @property
    def next_name(self) -> str:
        """What the part after this one will be called."""
        return self._path(self.number + 1).name

    def full(self, clock_ns: int) -> bool:
        """Say whether the part is to end, at a time of the recording."""
        if not self.rotating:
            return False
        if self._begun_ns is None:
            self._begun_ns = clock_ns
        config = self._config
        too_long = bool(config.rotate_ns) and clock_ns - self._begun_ns >= config.rotate_ns
        return too_long or bool(self.rotate_bytes and self.file.position >= self.rotate_bytes)

    def drop_old(self) -> list[str]:
        """Delete the oldest parts where there are too many, or too much in all; return why one cannot be deleted.

        Called when a checkpoint says that the present part was begun: what was kept for the ones before is needed no more.
        """
        for path in self._folder.glob("index.*"):
            if self._index is None or path != self._index.path:
                path.unlink(missing_ok=True)
        config = self._config
        if not (self.rotating and (config.keep or config.max_total)):
            return []
        sizes: dict[Path, int] = {}
        for path in recording_parts.parts_named(self.log):
            if path != self.path and self._is_own(path):
                with contextlib.suppress(OSError):
                    sizes[path] = path.stat().st_size
        total = sum(sizes.values()) + self.file.position
        refused = []
        for at, (path, size) in enumerate(sizes.items()):
            too_many = config.keep and len(sizes) - at + 1 > config.keep
            too_much = config.max_total and total > config.max_total
            if not too_many and not too_much:
                break
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                refused.append(f"{path.name} is to be deleted and cannot be: {error.strerror or error}")
            total -= size
        # Of many that cannot be deleted the first tells enough.
        return refused[:1]

    def about(self) -> dict[str, str]:
        """Return the metadata of the part itself."""
        config = self._config
        values = {
            "source": "recording",
            "format": "live",
            "recording": self.recording,
            "part": str(self.number),
            "previous": self.previous,
            "version": __version__,
            "time_source": TIME_SOURCE,
            "anchor_utc": iso(config.anchor_utc_ns),
            "anchor_monotonic_ns": str(config.anchor_monotonic_ns),
            "command": config.command,
            "model": config.model,
            "raw_only": "true" if config.raw_only else "",
        }
        return {name: value for name, value in values.items() if value}

    # --- names ----------------------------------------------------------------------------------------------------

    def _path(self, number: int) -> Path:
        return recording_parts.part_path(self.log, number) if self.rotating else self.log

    def _index_path(self, number: int) -> Path:
        return self._folder / f"index.{number:04d}"

    def _is_own(self, path: Path) -> bool:
        """Say whether a log is of this recording, or was begun and never written to."""
        try:
            found = path.stat()
        except OSError:
            # A link that leads nowhere, or a file that has gone since it was listed.
            return False
        empty = found.st_size == 0
        return stat.S_ISREG(found.st_mode) and (empty or recording_parts.look(path).recording == self.recording)

    def _drop_later(self) -> None:
        """Delete what a process began behind the checkpoint: all of it is still in the spools."""
        if self.rotating:
            named = recording_parts.parts_named(self.log)
            later = named[named.index(self.path) + 1 :] if self.path in named else []
            for path in later:
                if self._is_own(path):
                    path.unlink()
