"""The bytes of a capture: from a file or a pipe, unpacked where they are compressed, hashed as they pass.

    file or pipe -> block -> (gzip, zstd) -> (UTF-16 text) -> format reader

Rules:

1. Nothing seeks and nothing reads ahead of need, so a pipe gives what it has at once.
2. Memory is bounded: a block is at most `BLOCK` bytes as read and `UNPACKED` once unpacked. No header can raise that.
3. `position` counts bytes as they lie in the file, compressed ones too; it only grows.

What it does not know: what the bytes mean.
"""

from __future__ import annotations

import codecs
import errno
import hashlib
import os
import stat
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from analyzer.errors import UnreadableError
from analyzer.sources.budget import Budget
from analyzer.values import storable

#: Bytes of one read.
BLOCK = 64 * 1024
#: Bytes that one step of a decompressor may give.
UNPACKED = 1 << 20
#: One zstd block of 4 bytes can hold 128 KiB, so only few bytes are unpacked in one step.
_ZSTD_STEP = 256
_ZSTD_WINDOW = 1 << 27

GZIP_MAGIC = b"\x1f\x8b\x08"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BOMS = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}

#: What is wrong with a symbolic link that cannot be opened.
_LINK_ERRORS = {errno.ELOOP: "that leads back to itself", errno.ENOENT: "to a file that does not exist"}

Report = Callable[[str], None]


class Stream:
    """The unpacked bytes of a file or a pipe, in order, once.

    `report` is told what is wrong with the compressed data, and of a file that is cut while it is read. `size`: bytes of
    the file, None for a pipe. `compression`: "gzip", "zstd" or "".
    """

    def __init__(self, path: str, report: Report) -> None:
        self.path = path
        self.name = "standard input" if path == "-" else storable(Path(path).name or path)
        self._report = report
        self._fd, self.size = _open(path)
        self._closable = path != "-"
        self._hash = hashlib.sha256()
        self._ended = self._skipped = False
        self._failure: UnreadableError | None = None
        self.position = 0
        self.budget = Budget(self.name)
        self.compression = ""
        self._held = b""
        self._blocks = self._start()

    # --- reading --------------------------------------------------------------------------------------------------

    def block(self) -> bytes:
        """Return the next bytes, as many as there are at once; none at the end.

        Raises UnreadableError for a decompression bomb, and for a medium that fails at once: see `check`.
        """
        if self._held:
            held, self._held = self._held, b""
            return held
        return next(self._blocks, b"")

    def exactly(self, count: int) -> bytes:
        """Return `count` bytes, fewer only at the end.

        The caller bounds `count`.
        """
        if len(self._held) >= count:
            taken, self._held = self._held[:count], self._held[count:]
            return taken
        parts, size = [], 0
        while size < count:
            block = self.block()
            if not block:
                break
            parts.append(block)
            size += len(block)
        joined = b"".join(parts)
        if size > count:
            self._held = joined[count:]
            return joined[:count]
        return joined

    def skip(self, count: int) -> None:
        """Pass bytes over without reading them where that can be; the hash of the file is not known then."""
        held = len(self._held)
        if self.compression or self.size is None or count <= held:
            self.exactly(count)
            return
        self._held = b""
        self.position += count - held
        self._skipped = True

    def unread(self, data: bytes) -> None:
        """Put bytes back: they come again before all others."""
        self._held = data + self._held

    def drain(self) -> None:
        """Read to the end of the file for the sake of its hash."""
        while self._raw():
            pass

    def check(self) -> None:
        """Raise UnreadableError where the medium failed on the way: so its bytes before that place come first."""
        if self._failure is not None:
            raise self._failure

    @property
    def sha256(self) -> str | None:
        """SHA-256 of the file as it lies, in hex; None before its end was read."""
        return self._hash.hexdigest() if self._ended and not self._skipped else None

    def close(self) -> None:
        """Close the file. Closing twice is fine."""
        if self._fd >= 0 and self._closable:
            os.close(self._fd)
        self._fd = -1

    # --- from the medium ------------------------------------------------------------------------------------------

    def _raw(self) -> bytes:
        if self._ended or self._fd < 0:
            return b""
        try:
            # At its own position: a process forked meanwhile shares that of the descriptor.
            data = os.read(self._fd, BLOCK) if self.size is None else _read_at(self._fd, BLOCK, self.position)
        except OSError as error:
            failure = UnreadableError(f"{self.name}: reading failed at byte {self.position}: {error.strerror}")
            if not self.position:
                raise failure from None
            self._failure, self._ended, self._skipped = failure, True, True
            return b""
        self._hash.update(data)
        self.position += len(data)
        self.budget.read += len(data)
        self._ended = not data
        if self._ended and self.size is not None and self.position < self.size:
            self._skipped = True
            self._report(f"the file ends at byte {self.position} of {self.size}: it was cut while it was read")
        return data

    def _start(self) -> Iterator[bytes]:
        """Yield unpacked blocks."""
        first = b""
        while len(first) < len(ZSTD_MAGIC):
            more = self._raw()
            if not more:
                break
            first += more
        blocks = self._plain(first)
        for name, magic, opener in _OPENERS:
            if first.startswith(magic):
                self.compression = name
                blocks = self._guarded(opener(blocks, self._damaged))
                break
        yield from _as_utf8(blocks)

    def _plain(self, first: bytes) -> Iterator[bytes]:
        if first:
            yield first
        while block := self._raw():
            yield block

    def _damaged(self, text: str) -> None:
        self._report(f"{self.compression} data: {text} (at byte {self.position} of the file)")

    def _guarded(self, blocks: Iterator[bytes]) -> Iterator[bytes]:
        for block in blocks:
            self.budget.unpacked(len(block))
            yield block


def _at(fd: int, count: int, position: int) -> bytes:
    os.lseek(fd, position, os.SEEK_SET)
    return os.read(fd, count)


#: Reads from a position; systems that cannot do so at once do not fork either.
_read_at: Callable[[int, int, int], bytes] = getattr(os, "pread", _at)


def _open(path: str) -> tuple[int, int | None]:
    """Return a descriptor for reading, and the size of a regular file (None for others)."""
    if path == "-":
        try:
            return sys.stdin.fileno(), None
        except (OSError, ValueError, AttributeError):
            raise UnreadableError("standard input cannot be read: it is closed") from None
    try:
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOCTTY", 0))
    except ValueError as error:
        raise UnreadableError(f"{path!r} is not a path: {error}") from None
    except OSError as error:
        if Path(path).is_dir():
            raise UnreadableError(f"{path} is a folder, expected a capture file") from None
        if Path(path).is_symlink() and error.errno in _LINK_ERRORS:
            raise UnreadableError(f"{path} is a symbolic link {_LINK_ERRORS[error.errno]}, expected a capture file") from None
        raise UnreadableError(f"{path}: {error.strerror}") from None
    mode = os.fstat(fd).st_mode
    wrong = next((what for test, what in _NO_CAPTURE if test(mode)), None)
    if wrong is not None:
        os.close(fd)
        raise UnreadableError(f"{path} is {wrong}, expected a capture file")
    return fd, os.fstat(fd).st_size if stat.S_ISREG(mode) else None


_NO_CAPTURE: tuple[tuple[Callable[[int], bool], str], ...] = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a block device"),
)


def _gzip(blocks: Iterator[bytes], damaged: Report) -> Iterator[bytes]:
    """Yield what gzip data unpacks to; several members follow each other as one stream."""
    unpacker = zlib.decompressobj(31)
    for block in blocks:
        data, more = block, True
        while data or more:
            if unpacker.eof:
                # Some writers pad their files with zeros.
                data = data.lstrip(b"\0")
                if not data:
                    break
                if not GZIP_MAGIC.startswith(data[:3]):
                    damaged(f"the bytes after its end are not gzip data ({data[:4].hex(' ').upper()} ...), ignored")
                    return
                unpacker = zlib.decompressobj(31)
            before = unpacker.copy()
            try:
                unpacked = unpacker.decompress(data, UNPACKED)
            except zlib.error as error:
                yield from _salvaged(before, data)
                damaged(str(error))
                return
            data = unpacker.unconsumed_tail or unpacker.unused_data
            # A full step may have left output inside the decompressor.
            more = len(unpacked) == UNPACKED and not unpacker.eof
            if unpacked:
                yield unpacked
    if not unpacker.eof:
        damaged("ends too early")


def _salvaged(unpacker: zlib._Decompress, data: bytes) -> Iterator[bytes]:
    """Yield what comes out before the place where the data is damaged: the step that meets it gives nothing."""
    for at in range(len(data)):
        try:
            unpacked = unpacker.decompress(data[at : at + 1])
        except zlib.error:
            return
        if unpacked:
            yield unpacked


def _zstd(blocks: Iterator[bytes], damaged: Report) -> Iterator[bytes]:
    """Yield what zstd data unpacks to; several frames follow each other as one stream."""
    import zstandard

    context = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW)
    unpacker = context.decompressobj()
    begun = False
    for block in blocks:
        parts: list[bytes] = []
        size = at = 0
        while at < len(block):
            step = block[at : at + _ZSTD_STEP]
            at += len(step)
            while step:
                try:
                    unpacked = unpacker.decompress(step)
                except zstandard.ZstdError as error:
                    if parts:
                        yield b"".join(parts)
                    damaged(str(error))
                    return
                begun = True
                step = b""
                if unpacker.eof:
                    step = unpacker.unused_data
                    unpacker = context.decompressobj()
                    begun = bool(step)
                parts.append(unpacked)
                size += len(unpacked)
                if size >= UNPACKED:
                    yield b"".join(parts)
                    parts, size = [], 0
        if size:
            yield b"".join(parts)
    if begun:
        damaged("ends too early")


_OPENERS: tuple[tuple[str, bytes, Callable[[Iterator[bytes], Report], Iterator[bytes]]], ...] = (
    ("gzip", GZIP_MAGIC, _gzip),
    ("zstd", ZSTD_MAGIC, _zstd),
)


def _as_utf8(blocks: Iterator[bytes]) -> Iterator[bytes]:
    """Yield the blocks; text in UTF-16, as a Windows shell redirects it, as UTF-8."""
    first = next(blocks, b"")
    encoding = _BOMS.get(first[:2])
    half = first[2:][1::2] if encoding == "utf-16-le" else first[2:][0::2]
    # A raw capture may begin with these two bytes; then every other byte would not be zero.
    if encoding is None or len(first) < 4 or half.count(0) < 0.9 * len(half):
        if first:
            yield first
        yield from blocks
        return
    decoder = codecs.getincrementaldecoder(encoding)("replace")
    yield decoder.decode(first[2:]).encode("utf-8", "replace")
    for block in blocks:
        yield decoder.decode(block).encode("utf-8", "replace")
