"""What tests of the pipeline share: a sink that keeps everything, and short ways to feed it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from analyzer import dialects
from analyzer.catalogue import Dialect, Role
from analyzer.decoder import physical
from analyzer.entries import Entry
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment, Finding, Junk

MS = 1_000_000


class Collect:
    """Keeps entries, junk and findings in the order in which they came."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.pieces: list[Junk] = []
        self.findings: list[Finding] = []
        self.comments: list[Comment] = []

    def entry(self, entry: Entry) -> None:
        self.entries.append(entry)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self.pieces.append(junk)

    def finding(self, found: Finding) -> None:
        self.findings.append(found)

    def comment(self, comment: Comment) -> None:
        self.comments.append(comment)

    @property
    def rules(self) -> list[str]:
        return [f.rule for f in self.findings]

    @property
    def shown(self) -> list[tuple[str, dict]]:
        """Topic without the bus, and the fields, of each frame."""
        return [(e.topic.split("/", 2)[2], physical(e.message)) for e in self.entries]

    @property
    def topics(self) -> list[str]:
        return [e.topic.split("/", 2)[2] for e in self.entries]


def run(items: Iterable, names: str | Sequence[Dialect], **options: object) -> Collect:
    """Run items through a pipeline of the named dialects (blank between names)."""
    chosen = [dialects.get(n) for n in names.split()] if isinstance(names, str) else list(names)
    sink = Collect()
    Pipeline(chosen, (sink,), Options(**options)).run(items)  # type: ignore[arg-type]
    return sink


def serial(names: str | Sequence[Dialect], *frames: str | tuple[float, str], **options: object) -> Collect:
    """Run hex texts through a serial pipeline; a text may come with its time in ms."""
    items = []
    for each in frames:
        at, text = (None, each) if isinstance(each, str) else each
        direction = Role.UNKNOWN
        if text[0] in "<>":
            direction, text = (Role.REQUEST if text[0] == ">" else Role.REPLY), text[1:]
        t_ns = None if at is None else int(at * MS)
        items.append(Chunk(t_ns, "bus", bytes.fromhex(text), direction, burst=at is not None))
    return run(items, names, **options)


def can(*frames: str | tuple[float, str], names: str = "mks-can", **options: object) -> Collect:
    """Run frames such as `001#F60140023A`, maybe with their time in ms, through a CAN pipeline."""
    items = []
    for number, each in enumerate(frames):
        at, text = (float(number), each) if isinstance(each, str) else each
        identifier, _, data = text.partition("#")
        items.append(CanFrame(int(at * MS), "can0", int(identifier, 16), bytes.fromhex(data)))
    return run(items, names, **options)


def sum8(text: str) -> str:
    """Return hex text with its 8-bit sum added."""
    data = bytes.fromhex(text)
    return (data + bytes((sum(data) & 0xFF,))).hex(" ")


def rtu(text: str) -> bytes:
    """Return the bytes of hex text with their Modbus CRC behind them."""
    return bytes.fromhex(crc(text))


def crc(text: str) -> str:
    """Return hex text with its Modbus CRC added, computed bit by bit and not by the library the product uses."""
    value = 0xFFFF
    data = bytes.fromhex(text)
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return (data + value.to_bytes(2, "little")).hex(" ")
