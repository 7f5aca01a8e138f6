#!/usr/bin/env python3
"""How well frames are found on a noisy line, compared with pymodbus' RTU framer and a splitter by read chunks.

    python benchmarks/framing_noise.py [--frames N] [--seed N] [--json]

Traffic: plausible exchanges from the catalogue, each a request with valid values and its replies. They mix all commands of a
dialect and several drives; some requests go to all drives, some packages to five. Damage: each
byte of the line is flipped (another value), dropped, or has a byte inserted before it, one third each, with the given
probability.

    without timing   one stream of bytes, cut into reads at random places
    with timing      one read for each frame, with its time of arrival and real pauses between

What is counted:

    found    frames reported with a good checksum, of those that no damage touched or abuts (no byte of the frame and no
             byte beside it was changed, dropped or inserted)
    false    frames reported with a good checksum whose bytes are no sent frame within 2 bytes of that place
    named    those of them that carry a finding of a wrong length or an unknown code: where pauses say that a heap of
             bytes is one frame and its check fits, it is reported as such a frame, and a sum does not see lost zeros

The analyzer runs as it does in `servotap decode`: framer, decoder and transactions. The splitter takes each read for a
frame and keeps those whose check fits. pymodbus reads one direction of a line only. So it gets requests and replies
separately, and byte by byte, so that it loses no frame in a read of two. The analyzer gets neither help.
"""

from __future__ import annotations

import argparse
import bisect
import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.codec import codec
from analyzer.entries import Entry
from analyzer.layout import Field, FieldKind, Layout
from analyzer.link import READS, WRITE_ONE
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import Chunk, Comment, Finding, Junk

#: One byte at 115200 baud, ten bits.
BYTE_NS = 86_806
#: Frames a stream is made of; a run of more is several streams.
STREAM_FRAMES = 20_000
ROWS: dict[str, tuple[str, ...]] = {
    "mks-rs485": ("mks-rs485",),
    "mks-modbus": ("mks-modbus",),
    "lk-rs485": ("lk-rs485",),
    "mks-rs485 + mks-modbus": ("mks-rs485", "mks-modbus"),
}
DAMAGES = (0.0, 0.001, 0.01, 0.05)
#: Findings that say that a frame is not one of the manual's.
STRANGE_RULES = ("wrong_length", "short_package", "unknown_command")
#: Shares of requests to all drives, of exchanges with no reply, and of interim replies that a final one follows.
TO_ALL, UNANSWERED, COMPLETED = 0.02, 0.03, 0.5


class SentFrame(NamedTuple):
    """A frame as it was sent."""

    data: bytes
    role: Role
    dialect: Dialect


class Placed(NamedTuple):
    """A sent frame and where it lies on the damaged line. `clean`: no damage touched or abuts it."""

    sent: SentFrame
    at: int
    stop: int
    clean: bool


class Found(NamedTuple):
    """A frame that a framer reports with a good check. `named`: it says that its length or code is wrong."""

    at: int
    data: bytes
    named: bool = False


class Score(NamedTuple):
    """What a framer made of a line."""

    clean: int
    found: int
    false: int
    named: int
    sent: int
    line: int

    def __add__(self, other: Score) -> Score:  # type: ignore[override]
        return Score(*(a + b for a, b in zip(self, other, strict=True)))

    @property
    def share(self) -> float:
        return self.found / self.clean if self.clean else 1.0

    @property
    def false_per_million(self) -> float:
        return self.false / self.line * 1e6 if self.line else 0.0


# --- traffic ----------------------------------------------------------------------------------------------------------


def value_of(field: Field, random: Random) -> int:
    """Return a valid value: often a small or an extreme one, else any."""
    if field.fixed is not None:
        return field.fixed
    if field.kind is FieldKind.RESERVED:
        return 0
    listed = sorted(v for v in (field.values or field.choice_names) if field.allows(v))
    if listed:
        return random.choice(listed)
    low, high = field.low, field.high
    kind = random.random()
    if kind < 0.15:
        return random.choice((low, high, max(low, min(high, field.default or 0))))
    if kind < 0.4:
        return random.randint(max(low, -1000), max(max(low, -1000), min(high, 1000)))
    return random.randint(low, high)


def values_of(layout: Layout, random: Random, known: dict[str, int] | None = None) -> dict[str, int]:
    """Return valid values for a layout; fields of the same name as in `known` take that value where they may."""
    result = {}
    for field in layout.fields:
        if field.kind in (FieldKind.RESERVED, FieldKind.BYTES):
            continue
        kept = (known or {}).get(field.name)
        result[field.name] = kept if kept is not None and field.allows(kept) else value_of(field, random)
    return result


def package_data(dialect: Dialect, command: Command, random: Random) -> bytes:
    """Return the slots of a package, one to all of them used."""
    assert command.slots is not None
    data = b""
    inner = [c for c in dialect.commands if c.slots is None]
    for address in range(1, random.randint(1, command.slots.count) + 1):
        slot = random.choice(inner)
        layout = slot.request_forms[0].layout
        body = codec(layout).encode(values_of(layout, random))
        data += (bytes((address, slot.code)) + body).ljust(command.slots.size, b"\0")
    return data.ljust(command.slots.count * command.slots.size, b"\0")


def answer(forms: Sequence[Form], asked: dict[str, int], random: Random) -> tuple[Form, dict[str, int]]:
    """Return a reply form that agrees with its request, and values for it; a refusal is rare."""
    fitting = [f for f in forms if all(asked.get(x.name, x.fixed) == x.fixed for x in f.layout.fields if x.fixed is not None)]
    chosen = random.choice([f for f in fitting if f.name != "refused"] or fitting or list(forms))
    if random.random() < 0.02:
        chosen = random.choice(fitting or list(forms))
    return chosen, values_of(chosen.layout, random, asked)


def exchange(dialect: Dialect, address: int, random: Random) -> list[SentFrame]:
    """Return the frames of one exchange of a random command with a drive."""
    command = random.choice(dialect.commands)
    form = random.choice(command.request_forms)
    link = dialect.link
    asked = values_of(form.layout, random)
    data = package_data(dialect, command, random) if command.slots else codec(form.layout).encode(asked)
    reads = command.function in READS
    to_all = dialect.broadcast is not None and not reads and command.broadcastable and random.random() < TO_ALL
    if to_all:
        address = dialect.broadcast or 0
    frames = [SentFrame(link.build(command, form, address, data, Role.REQUEST), Role.REQUEST, dialect)]
    if to_all or not command.reply_forms or random.random() < UNANSWERED:
        return frames
    if dialect.exception is not None and random.random() < 0.01:
        code = random.choice(sorted(dialect.exception.layout.fields[0].choice_names))
        body = bytes((address, (command.function or 0) | 0x80, code))
        return [*frames, SentFrame(link.completed(body), Role.REPLY, dialect)]
    reply, values = answer(command.reply_forms, asked, random)
    body = codec(reply.layout).encode(values)
    if command.function in WRITE_ONE and reply.name != "refused":
        body = data
    frames.append(SentFrame(link.build(command, reply, address, body, Role.REPLY), Role.REPLY, dialect))
    replies = command.replies
    if values.get(replies.status) in replies.interim and replies.final and random.random() < COMPLETED:
        values[replies.status] = random.choice(sorted(replies.final))
        body = codec(reply.layout).encode(values)
        frames.append(SentFrame(link.build(command, reply, address, body, Role.REPLY), Role.REPLY, dialect))
    return frames


def traffic(names: Sequence[str], count: int, random: Random) -> list[SentFrame]:
    """Return about `count` frames of several drives, each of one dialect."""
    drives: list[tuple[Dialect, int]] = []
    for name in names:
        dialect = dialects.get(name)
        first, last = dialect.addresses
        near = random.sample(range(first, first + 8), 4)
        drives += [(dialect, address) for address in (*near, random.randint(first, last))]
    frames: list[SentFrame] = []
    while len(frames) < count:
        dialect, address = random.choice(drives)
        frames += exchange(dialect, address, random)
    return frames


# --- damage -----------------------------------------------------------------------------------------------------------


def damage(frames: Sequence[SentFrame], share: float, random: Random) -> tuple[bytes, list[Placed]]:
    """Return the line after damage, and where each frame lies on it."""
    line = bytearray()
    #: For each byte sent: did anything happen to it; and was a byte inserted before it.
    hurt: list[bool] = []
    added: list[bool] = []
    starts: list[int] = []
    for frame in frames:
        starts.append(len(line))
        for byte in frame.data:
            insert = changed = False
            if share and random.random() < share:
                kind = random.randrange(3)
                changed = kind < 2
                insert = kind == 2
                if kind == 0:
                    line.append(byte ^ random.randint(1, 255))
                elif kind == 2:
                    line += bytes((random.randrange(256), byte))
            else:
                line.append(byte)
            hurt.append(changed)
            added.append(insert)
    placed = []
    first = 0
    ends = [*starts[1:], len(line)]
    for frame, at, stop in zip(frames, starts, ends, strict=True):
        last = first + len(frame.data)
        clean = not (any(hurt[max(0, first - 1) : last + 1]) or any(added[first : last + 1]))
        placed.append(Placed(frame, at, stop, clean))
        first = last
    return bytes(line), placed


def cuts(line: bytes, random: Random) -> list[bytes]:
    """Return the line in reads of random length, as an adapter would cut it."""
    pieces, at = list[bytes](), 0
    while at < len(line):
        size = random.choice((1, 2, 3, 8, 16, 31, 62, 64, 512, 4096))
        pieces.append(line[at : at + size])
        at += size
    return pieces


def timed(line: bytes, placed: Sequence[Placed], random: Random) -> list[tuple[int, bytes]]:
    """Return one read for each frame with the time of its last byte: replies after about 1 ms, requests after more."""
    reads, now = [], 1_000_000_000
    for frame in placed:
        data = line[frame.at : frame.stop]
        is_reply = frame.sent.role is Role.REPLY
        now += random.randint(500, 3000) * 1000 if is_reply else random.randint(2000, 30_000) * 1000
        now += len(data) * BYTE_NS
        if data:
            reads.append((now, data))
    return reads


# --- framers ----------------------------------------------------------------------------------------------------------


class Collector:
    """A sink that keeps the frames whose check fits."""

    def __init__(self) -> None:
        self.found: list[Found] = []
        self.bytes = 0

    def entry(self, entry: Entry) -> None:
        frame = entry.message.frame
        self.bytes += len(frame.data)
        if frame.checksum_ok:
            named = any(f.rule in STRANGE_RULES for f in entry.findings)
            self.found.append(Found(frame.offset, frame.data, named))

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self.bytes += len(junk.data)

    def finding(self, found: Finding) -> None:
        pass

    def comment(self, comment: Comment) -> None:
        pass


def by_analyzer(names: Sequence[str], chunks: Sequence[Chunk], options: Options) -> list[Found]:
    """Frame with the analyzer's pipeline."""
    sink = Collector()
    Pipeline([dialects.get(n) for n in names], [sink], options).run(chunks)
    expected = sum(len(c.data) for c in chunks)
    assert sink.bytes == expected, f"{expected} bytes in, {sink.bytes} out"
    return sink.found


def by_chunks(names: Sequence[str], chunks: Sequence[Chunk]) -> list[Found]:
    """Take each read for a frame and keep it if its check fits."""
    links = [dialects.get(n).link for n in names]
    found, at = list[Found](), 0
    for chunk in chunks:
        data = chunk.data
        if len(data) >= 4 and any(all(c.ok for c in link.checks(data)) for link in links):
            found.append(Found(at, data))
        at += len(data)
    return found


def by_pymodbus(line: bytes, placed: Sequence[Placed], apart: bool) -> list[Found]:
    """Frame requests and replies apart with pymodbus. `apart`: each frame is a read of its own, after a silence."""
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU

    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    found = []
    for role, is_server in ((Role.REQUEST, True), (Role.REPLY, False)):
        framer = FramerRTU(DecodePDU(is_server))
        held, places = bytearray(), list[int]()
        for frame in placed:
            if frame.sent.role is not role:
                continue
            if apart:
                held.clear()
                places.clear()
            for at in range(frame.at, frame.stop):
                held.append(line[at])
                places.append(at)
                used, _, _, pdu = framer.decode(bytes(held))
                if pdu:
                    # It tells the function and what follows: the frame is that, the address before and the CRC behind.
                    size = len(pdu) + 3
                    start = len(held) - size
                    found.append(Found(places[start], bytes(held[start:])))
                if used:
                    del held[:used]
                    del places[:used]
    return found


# --- figures ----------------------------------------------------------------------------------------------------------


def score(line: bytes, placed: Sequence[Placed], found: Sequence[Found]) -> Score:
    """Compare what was found with what was sent."""
    places = {(f.at, f.data) for f in found}
    clean = [p for p in placed if p.clean]
    hits = sum((p.at, p.sent.data) in places for p in clean)
    at = [p.at for p in placed]
    false = named = 0
    for one in found:
        near = placed[bisect.bisect_left(at, one.at - 2) : bisect.bisect_right(at, one.at + 2)]
        if all(p.sent.data != one.data for p in near):
            false += 1
            named += one.named
    return Score(len(clean), hits, false, named, len(placed), len(line))


def runs(names: Sequence[str], share: float, frames: int, seed: int) -> Iterator[tuple[str, str, Score]]:
    """Yield (timing, framer, score) of one stream."""
    random = Random(f"{seed} {share} {names}")
    line, placed = damage(traffic(names, frames, random), share, random)
    bare = [Chunk(None, "line", data) for data in cuts(line, random)]
    with_times = [Chunk(t_ns, "line", data) for t_ns, data in timed(line, placed, random)]
    untimed_options = Options(byte_ns=BYTE_NS, synthetic_byte_ns=BYTE_NS)
    yield "without", "servotap", score(line, placed, by_analyzer(names, bare, untimed_options))
    yield "with", "servotap", score(line, placed, by_analyzer(names, with_times, Options(byte_ns=BYTE_NS)))
    yield "without", "read chunks", score(line, placed, by_chunks(names, bare))
    yield "with", "read chunks", score(line, placed, by_chunks(names, with_times))
    if names == ROWS["mks-modbus"]:
        yield "without", "pymodbus", score(line, placed, by_pymodbus(line, placed, False))
        yield "with", "pymodbus", score(line, placed, by_pymodbus(line, placed, True))


def measure(
    rows: Sequence[str], damages: Sequence[float], frames: int, seed: int, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return one record for each row of the table."""
    records = []
    streams = max(1, -(-frames // STREAM_FRAMES))
    for row in rows:
        for share in damages:
            say(f"{row}, {share:.1%} damage")
            total: dict[tuple[str, str], Score] = {}
            for stream in range(streams):
                size = min(STREAM_FRAMES, frames)
                for timing, framer, one in runs(ROWS[row], share, size, seed + stream):
                    total[timing, framer] = total.get((timing, framer), Score(0, 0, 0, 0, 0, 0)) + one
            for (timing, framer), sums in total.items():
                records.append(
                    {
                        "dialect": row,
                        "damage": share,
                        "timing": timing,
                        "framer": framer,
                        **sums._asdict(),
                        "found_share": sums.share,
                        "false_per_million_bytes": sums.false_per_million,
                        "false_per_frame": sums.false / sums.sent,
                    }
                )
    return records


def table(records: Sequence[dict[str, Any]]) -> str:
    """Return the records as a markdown table."""
    lines = [
        "| dialect | damage | timing | framer | undamaged | found | false | named | per million bytes | one in |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in records:
        one_in = f"{r['sent'] / r['false']:,.0f} frames" if r["false"] else "none"
        lines.append(
            f"| {r['dialect']} | {r['damage']:.1%} | {r['timing']} | {r['framer']} | {r['clean']:,} | "
            f"{r['found_share']:.4%} | {r['false']} | {r['named']} | {r['false_per_million_bytes']:.1f} | {one_in} |"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--frames", type=int, default=100_000, help="frames a row (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first stream (default %(default)s)")
    parser.add_argument("--dialect", choices=ROWS, action="append", help="only these rows; may be given several times")
    parser.add_argument("--damage", type=float, action="append", help="only these shares of damaged bytes (0.01)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a markdown table")
    options = parser.parse_args(arguments)
    if options.frames < 1:
        parser.error("--frames: expected 1 or more")

    def say(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)

    records = measure(options.dialect or list(ROWS), options.damage or DAMAGES, options.frames, options.seed, say)
    say("")
    print(json.dumps(records, indent=1) if options.json else table(records))
    return 0


if __name__ == "__main__":
    sys.exit(main())
