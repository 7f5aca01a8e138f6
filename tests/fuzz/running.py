"""What every target does: run a command on files, hear what it says, and check what holds for every one."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader

from analyzer.cli import main
from analyzer.errors import ServotapError
from analyzer.records import CanFrame, Chunk
from analyzer.sources import open_source
from tests.fuzz.corpus import Input, lay_out

#: Bytes that a command may write for an input of at most 64 KiB.
WRITTEN_LIMIT = 64 << 20
_ESCAPES = (b"\x1b", b"\xc2\x9b")
#: How a pcapng file begins. It may be written to the standard output, and its packets hold any bytes.
_PCAPNG = re.compile(rb"\n\r\r\n.{4}\x4d\x3c\x2b\x1a", re.DOTALL)


class Fault(Exception):
    """Something that must hold does not."""


class Place(NamedTuple):
    """Where a target runs: a folder that is empty, and what was said on the two streams."""

    folder: Path
    said: Callable[[], bytes]


Run = Callable[[Input, Place], None]
Mutate = Callable[[random.Random, Input, Sequence[Input]], Input]


class Target(NamedTuple):
    """`share`: of the time; `seconds`: of processor time that one input may take.

    `forks`: what it loads outlives a fork; threads, and what runs in a process of its own, do not.
    """

    run: Run
    seeds: Callable[[], list[Input]]
    mutate: Mutate
    share: float = 1.0
    seconds: float = 10.0
    forks: bool = True


# --- streams ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def heard() -> Iterator[Callable[[], bytes]]:
    """Take both streams, also what is written past Python; yield what returns what came since it was asked last."""
    taken = os.memfd_create("said")
    kept = os.dup(1), os.dup(2)
    before = sys.stdout, sys.stderr
    for stream in before:
        stream.flush()
    os.dup2(taken, 1)
    os.dup2(taken, 2)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(io.FileIO(number, "w", closefd=False), "utf-8", errors, write_through=True)
        for number, errors in ((1, "strict"), (2, "backslashreplace"))
    )

    def said() -> bytes:
        size = os.lseek(taken, 0, os.SEEK_CUR)
        os.lseek(taken, 0, os.SEEK_SET)
        text = os.read(taken, size)
        os.lseek(taken, 0, os.SEEK_SET)
        os.ftruncate(taken, 0)
        return text

    try:
        yield said
    finally:
        sys.stdout, sys.stderr = before
        for number, old in zip((1, 2), kept, strict=True):
            os.dup2(old, number)
            os.close(old)
        os.close(taken)


# --- commands ---------------------------------------------------------------------------------------------------------


def run_words(words: Sequence[str], place: Place, statuses: Sequence[int] = (0, 1, 2)) -> int:
    """Run the command line and check what holds for every one; return its exit status, one of `statuses`."""
    return heard_words(words, place, statuses)[0]


def heard_words(words: Sequence[str], place: Place, statuses: Sequence[int] = (0, 1, 2)) -> tuple[int, bytes]:
    """Do the same; return what was said, too."""
    stdout = sys.stdout
    try:
        status = main(words)
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 2
    said = place.said()
    if sys.stdout is not stdout or sys.stdout.closed:
        raise Fault("the standard output was replaced")
    if b"Traceback" in said or status == 70:
        raise Fault(said.decode("utf-8", "replace"))
    if status not in statuses:
        raise Fault(f"exit status {status}")
    for escape in _ESCAPES:
        if escape in said and not _PCAPNG.search(said):
            at = said.index(escape)
            raise Fault(f"an escape on a stream: {said[max(0, at - 60) : at + 20]!r}")
    for path in place.folder.rglob("*"):
        if not path.is_symlink() and path.is_file() and path.stat().st_size > WRITTEN_LIMIT:
            raise Fault(f"{path.name} of {path.stat().st_size} bytes was written")
    return status, said


def command(*words: str) -> Run:
    """Return a target of a command on the files of an input: they lie in the folder it runs in."""

    def run(given: Input, place: Place) -> None:
        lay_out(given, place.folder)
        run_words(words, place)

    return run


def fed(path: Path, format: str | None = None) -> int:
    """Return how many bytes of traffic a capture holds."""
    size = 0
    with contextlib.suppress(ServotapError), open_source(path, format=format) as source:
        for item in source:
            if isinstance(item, (Chunk, CanFrame)):
                size += len(item.data)
    return size


def check_log(path: Path, size: int) -> None:
    """Check that the library reads a log, and that its frames and junk hold so many bytes, each in its place."""
    ends: dict[str, int] = {}
    whole = 0
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
            _, bus, *rest = channel.topic.split("/")
            value = json.loads(message.data)
            if "_raw" not in value or rest[-1:] == ["raw"]:
                continue
            data = bytes.fromhex(value["_raw"])
            whole += len(data)
            if value["_offset"] < ends.get(bus, 0):
                raise Fault(f"bytes of {bus} stand twice at {value['_offset']}")
            ends[bus] = value["_offset"] + len(data)
    if whole != size:
        raise Fault(f"{size} bytes came in, {whole} stand in the log")


def messages(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Yield topic and data of every message of all logs, as the library reads them."""
    for path in folder.glob("*.mcap"):
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                yield channel.topic, message.data
