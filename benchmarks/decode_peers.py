"""`servotap decode` compared with plain scripts that do a part of its work, in the same run.

    python benchmarks/decode_peers.py [--frames 100000] [--rounds 3]

Two captures of plausible exchanges are made: candump lines of MKS on CAN, and raw bytes of MKS native frames. The peers:

- candump: python-can reads, cantools decodes by a database with a multiplexer, json writes, mcap logs;
- raw: a hand-written slicer for exactly these commands, struct, json, mcap.

The peers do not pair frames, report findings or check ranges. Absolute numbers depend on the machine; compare the ratios.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.cli import main as servotap  # noqa: E402
from analyzer.layout import FieldKind  # noqa: E402


def database():
    """Return a cantools database of the drives' replies, multiplexed by the code byte, from the catalogue."""
    from cantools.database import Database, Message, Signal
    from cantools.database.conversion import LinearConversion

    dialect = dialects.get("mks-can")
    signals = [Signal("code", 7, 8, is_multiplexer=True, byte_order="big_endian")]
    seen: set[int] = set()
    for command in dialect.commands:
        form = next((f for f in command.reply_forms if f.code is None and not f.needs_request), None)
        if form is None or command.code in seen:
            continue
        seen.add(command.code)
        for offset, field in form.layout:
            if field.kind is FieldKind.RESERVED:
                continue
            bit = offset + 8
            signals.append(
                Signal(
                    f"{command.name}_{field.name}",
                    bit // 8 * 8 + 7 - bit % 8,
                    field.bit_width,
                    byte_order="big_endian",
                    is_signed=field.kind is FieldKind.INT,
                    conversion=LinearConversion(float(field.scale), 0, False),
                    multiplexer_ids=[command.code],
                    multiplexer_signal="code",
                )
            )
    return Database(messages=[Message(i, f"drive_{i}", 8, signals, strict=False) for i in range(1, 5)])


def plain_can(capture: Path, target: Path) -> int:
    """Decode a candump as a plain script would."""
    import can
    from mcap.writer import Writer

    known = database()
    count = 0
    channels: dict[int, int] = {}
    with target.open("wb") as stream, can.LogReader(str(capture)) as reader:
        writer = Writer(stream)
        writer.start("", "plain")
        schema = writer.register_schema("drive", "jsonschema", b'{"type":"object"}')
        for message in reader:
            fields: dict = {}
            # Requests and short replies do not fill the signals; a plain script keeps their bytes.
            with contextlib.suppress(Exception):
                fields = dict(known.decode_message(message.arbitration_id, message.data, False, allow_truncated=True))
            fields["_raw"] = bytes(message.data).hex(" ")
            channel = channels.get(message.arbitration_id)
            if channel is None:
                topic = f"/can0/{message.arbitration_id}"
                channel = channels[message.arbitration_id] = writer.register_channel(topic, "json", schema)
            t_ns = int(message.timestamp * 1e9)
            writer.add_message(channel, t_ns, json.dumps(fields).encode(), t_ns, count)
            count += 1
        writer.finish()
    return count


def plain_parquet(capture: Path, folder: Path) -> int:
    """Decode a candump likewise, into a table for each drive and code, through pandas."""
    import can
    import pandas

    known = database()
    rows: dict[tuple[int, int], list[dict]] = {}
    with can.LogReader(str(capture)) as reader:
        for message in reader:
            fields: dict = {}
            with contextlib.suppress(Exception):
                fields = dict(known.decode_message(message.arbitration_id, message.data, False, allow_truncated=True))
            row = {"time": message.timestamp, "address": message.arbitration_id, **fields, "_raw": bytes(message.data)}
            rows.setdefault((message.arbitration_id, message.data[0]), []).append(row)
    folder.mkdir(exist_ok=True)
    for (drive, code), each in rows.items():
        pandas.DataFrame(each).to_parquet(folder / f"{drive}_{code:02X}.parquet")
    return sum(map(len, rows.values()))


def slicer_tables() -> tuple[dict[int, set[int]], dict[int, dict[int, tuple[str, str, list[str]]]]]:
    """Return the frame lengths by head and code, and how to unpack them: written out as a plain script would have them."""
    dialect = dialects.get("mks-rs485")
    sizes = {8: "B", 16: "H", 32: "I"}
    tables: dict[int, dict[int, tuple[str, str, list[str]]]] = {0xFA: {}, 0xFB: {}}
    for head, which in ((0xFA, "request_forms"), (0xFB, "reply_forms")):
        for command in dialect.commands:
            for form in getattr(command, which):
                if command.slots is not None:
                    continue
                text, names = ">", []
                for field in form.layout.fields:
                    code = sizes.get(field.bit_width)
                    if code is None:
                        text, names = f">{form.layout.byte_length}s", ["data"]
                        break
                    text += code.lower() if field.kind is FieldKind.INT else code
                    names.append(field.name)
                tables[head][command.code] = (command.name, text, names)
    lengths = {h: {c: struct.calcsize(t[1]) + 4 for c, t in codes.items()} for h, codes in tables.items()}
    return lengths, tables


def plain_raw(capture: Path, target: Path) -> int:
    """Decode raw bytes as a plain script would: a table of lengths, a sum, struct."""
    from mcap.writer import Writer

    lengths, tables = slicer_tables()
    data = capture.read_bytes()
    end, at, count = len(data), 0, 0
    channels: dict[tuple[int, int, int], int] = {}
    with target.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "plain")
        schema = writer.register_schema("drive", "jsonschema", b'{"type":"object"}')
        while at + 2 < end:
            head, address, code = data[at], data[at + 1], data[at + 2]
            size = lengths.get(head, {}).get(code)
            if size is None or at + size > end or sum(data[at : at + size - 1]) & 0xFF != data[at + size - 1]:
                at += 1
                continue
            frame = data[at : at + size]
            name, text, names = tables[head][code]
            values = struct.unpack(text, frame[3:-1])
            fields = {n: v.hex() if isinstance(v, bytes) else v for n, v in zip(names, values, strict=True)}
            fields["_raw"] = frame.hex(" ")
            fields["_offset"] = at
            channel = channels.get((head, address, code))
            if channel is None:
                role = "request" if head == 0xFA else "reply"
                topic = f"/bus/{address}/{name}/{role}"
                channel = channels[head, address, code] = writer.register_channel(topic, "json", schema)
            t_ns = at * 260_416
            writer.add_message(channel, t_ns, json.dumps(fields).encode(), t_ns, count)
            count += 1
            at += size
        writer.finish()
    return count


def ours(capture: Path, target: Path, *words: str) -> int:
    """Decode by `servotap decode`, everything it does included."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = servotap(["decode", str(capture), "-o", str(target), "--force", "--json", *words])
    assert status == 0
    return int(json.loads(out.getvalue())["frames"])


def timed(work: Callable[[], int], frames: int) -> float:
    """Return the frames per second of a run, and check that it found them."""
    started = time.perf_counter()
    count = work()
    spent = time.perf_counter() - started
    assert count >= 0.99 * frames, (count, frames)
    return count / spent


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    frames = arguments.frames
    with tempfile.TemporaryDirectory() as folder:
        raw, dump, target = Path(folder, "wire.bin"), Path(folder, "can.log"), Path(folder, "out.mcap")
        make = [sys.executable, str(ROOT / "captures" / "make.py"), "--frames", str(frames), "-o"]
        subprocess.run([*make, str(raw)], check=True)
        subprocess.run([*make, str(dump), "--dialect", "mks-can"], check=True)
        rows = (
            ("candump", lambda: ours(dump, target), lambda: plain_can(dump, target)),
            ("raw bytes", lambda: ours(raw, target, "--dialect", "mks-rs485"), lambda: plain_raw(raw, target)),
        )
        print("| capture | servotap decode, frames/s | plain script, frames/s | ratio |\n| --- | --- | --- | --- |")
        for name, mine, theirs in rows:
            # In turn, so that a drift of the machine's speed hits both.
            pairs = [(timed(mine, frames), timed(theirs, frames)) for _ in range(arguments.rounds)]
            ratio = statistics.median(a / b for a, b in pairs)
            a, b = (statistics.median(p[i] for p in pairs) for i in (0, 1))
            print(f"| {name} | {a:,.0f} | {b:,.0f} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
