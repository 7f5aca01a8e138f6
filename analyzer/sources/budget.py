"""What a small file may grow to: bytes and records for each of its bytes, for every format and every compression.

    gzip, zstd    MCAP chunks    BLF containers    the lines, blocks and messages inside    the process that reads MF4
    samples of a logic analyzer in zip

A file pays for what it unpacks to from one budget, which grows with the bytes that were read of it. Real captures stay below:
a log of one poll over and over, which compresses best, has 300 bytes and 10 records for each byte. What is not compressed is
never refused: it has at most one record for each byte.
"""

from __future__ import annotations

from analyzer.errors import UnreadableError
from analyzer.values import counted

#: What every file may unpack to, and how much more for each of its bytes.
FREE_BYTES, BYTES_PER_BYTE = 4 << 20, 400
FREE_RECORDS, RECORDS_PER_BYTE = 1 << 15, 12
#: What samples of an idle line may unpack to: they compress best, and only their edges are kept.
FREE_SAMPLES = 1 << 30
#: Bytes of one record in the file, and of one container or chunk unpacked; writers stay at 1 MiB.
RECORD_LIMIT = 64 << 20
CONTAINER_LIMIT = 64 << 20
#: Bytes that signs for "the same again" may stand for, and how many more for each byte of the file.
FREE_REPEATED, REPEATED_PER_BYTE = 1 << 20, 16
#: Of a process that reads a file with a library that has no bounds: bytes of memory and seconds, and more for each MiB.
CHILD_BYTES, CHILD_BYTES_PER_MIB = 500 << 20, 20 << 20
CHILD_SECONDS, CHILD_SECONDS_PER_MIB = 20, 10


def child_limits(size: int) -> tuple[int, int]:
    """Return the bytes of memory and the seconds of CPU time for a file of a size."""
    mib = -(-size // (1 << 20))
    return CHILD_BYTES + CHILD_BYTES_PER_MIB * mib, CHILD_SECONDS + CHILD_SECONDS_PER_MIB * mib


class Budget:
    """What one file has spent. `name`: of the capture; `read`: bytes of the file so far, as they lie there."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.read = 0
        self._bytes = 0
        self._records = 0
        self._repeated = 0

    def unpacked(self, size: int) -> None:
        """Pay for bytes that came out of a decompressor. Raises UnreadableError where they are too many."""
        self._bytes += size
        if self._bytes > FREE_BYTES and self._bytes > FREE_BYTES + BYTES_PER_BYTE * self.read:
            self._refuse("bytes", FREE_BYTES, BYTES_PER_BYTE)

    def container(self, size: int, packed: int) -> None:
        """Pay for a container that grew from `packed` bytes to `size`, or to more than it may. Raises as `unpacked`."""
        if size > CONTAINER_LIMIT:
            raise UnreadableError(
                f"{self.name}: a container of {counted(packed, 'byte')} unpacks to more than {CONTAINER_LIMIT >> 20} MiB, "
                f"expected 1 MiB at most: taken for a decompression bomb; {_ADVICE}"
            )
        self.unpacked(size)

    def samples(self, size: int, packed: int) -> None:
        """Pay for samples of a logic analyzer that `packed` bytes claim to hold. Raises UnreadableError for too many."""
        if size > FREE_SAMPLES + BYTES_PER_BYTE * packed:
            raise UnreadableError(
                f"{self.name}: {counted(packed, 'byte')} claim to hold {size} bytes of samples, expected at most "
                f"{FREE_SAMPLES + BYTES_PER_BYTE * packed}: taken for a decompression bomb; {_ADVICE}"
            )

    def record(self, count: int = 1) -> None:
        """Pay for lines, blocks, objects or messages. Raises UnreadableError where they are too many."""
        self._records += count
        if self._records > FREE_RECORDS and self._records > FREE_RECORDS + RECORDS_PER_BYTE * self.read:
            self._refuse("records", FREE_RECORDS, RECORDS_PER_BYTE)

    def repeat(self, size: int) -> bool:
        """Pay for bytes that a sign for "the same again" stands for; say whether they can be paid."""
        if self._repeated + size > FREE_REPEATED + REPEATED_PER_BYTE * self.read:
            return False
        self._repeated += size
        return True

    def _refuse(self, what: str, free: int, each: int) -> None:
        raise UnreadableError(
            f"{self.name}: {counted(self.read, 'byte')} of the file became more than {free + each * self.read} {what}, "
            f"expected at most {free} and {each} for each byte: taken for a decompression bomb; {_ADVICE}"
        )


_ADVICE = "if it is harmless, unpack it first (gunzip, unzstd, unzip), or write it again without compression"
