"""Logs that are damaged inside, through `cut`, `merge` and `export`: what is good is copied, what is not is named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from analyzer.cli import main, reading
from tests.sources import builders

FRAMES = ("FA 01 F6 01 40 02 34", "FB 01 F6 01 F3")
GOOD = 40
DAMAGED = {
    "utf-8": b'{"event": "part", "bus": "\xff\xfe", "line": 3, "file": "/left/x"}',
    "no-json": b'{"event": ',
    "depth": b'{"event": ' + b"[" * 20_000,
    "number": b'{"event": "port", "bus": "left", "offset": 1e400, "line": ' + b"9" * 5000 + b"}",
    "types": b'{"event": {}, "bus": [1], "line": "x", "file": 5, "message": [], "_request_sequence":99999999999999999999}',
    "list": b"[1, 2]",
}
COMMANDS = {
    "cut": ["cut", "{log}", "--since", "+0.01s", "-o", "{out}.mcap"],
    "cut-bus": ["cut", "{log}", "--bus", "left", "-o", "{out}.mcap"],
    "merge": ["merge", "{other}", "{log}", "-o", "{out}.mcap"],
    "decode": ["decode", "{log}", "-o", "{out}.mcap"],
    "csv": ["export", "{log}", "-o", "{out}.csv"],
    "wide": ["export", "{log}", "--wide", "-o", "{out}.csv"],
    "hex": ["export", "{log}", "--to", "hex", "-o", "{out}.txt"],
    "pcapng": ["export", "{log}", "-o", "{out}.pcapng"],
}


def log(
    path: Path, *damaged: bytes, topics: tuple[str, ...] = ("/recording", "/findings", "/comments", "/left/1/a/reply")
) -> Path:
    """A whole log with frames of one bus, a chunk each few of them, and damaged messages of several topics in between."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=300, compression=CompressionType.ZSTD)
        writer.start("servotap", "test")
        channels = {topic: writer.register_channel(topic, "json", 0) for topic in ("/left/1/run_speed/request", *topics)}
        offset = 0
        for n in range(GOOD):
            data = FRAMES[n % 2]
            body = json.dumps({"_raw": data, "_offset": offset}).encode()
            writer.add_message(channels["/left/1/run_speed/request"], 10**9 + n * 10**6, body, 10**9 + n * 10**6, n + 1)
            offset += len(bytes.fromhex(data))
            if n == GOOD // 2:
                for topic in topics:
                    for each in damaged:
                        writer.add_message(channels[topic], 10**9 + n * 10**6, each, 10**9 + n * 10**6, n + 1)
        writer.finish()
    return path


def frames_of(path: Path) -> int:
    with path.open("rb") as stream:
        return sum(b'"_raw"' in m.data for _, c, m in make_reader(stream).iter_messages() if c.topic.startswith("/"))


def run(command: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[Path, str]:
    other = log(tmp_path / "other.mcap")
    out = tmp_path / "out"
    words = [word.format(log=path, other=other, out=out) for word in COMMANDS[command]]
    status = main(words)
    told = capsys.readouterr()
    assert status == 0, told.err
    assert "Traceback" not in told.err
    return Path(words[-1]), told.out + told.err


@pytest.mark.parametrize("command", COMMANDS)
def test_damaged_messages_cost_themselves(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log(tmp_path / "log.mcap", *DAMAGED.values())
    out, _ = run(command, path, tmp_path, capsys)
    if command in ("cut-bus", "merge"):
        assert frames_of(out) == GOOD * (2 if command == "merge" else 1)
    elif command == "csv":
        assert sum("run_speed" in row for row in out.read_text().splitlines()) == GOOD


@pytest.mark.parametrize("command", COMMANDS)
def test_a_damaged_chunk_costs_itself_and_is_named(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log(tmp_path / "log.mcap")
    data = bytearray(path.read_bytes())
    # In the compressed data of the fifth chunk.
    at = -1
    for _ in range(5):
        at = data.index(b"\x28\xb5\x2f\xfd", at + 1)
    data[at : at + 30] = b"\xff" * 30
    path.write_bytes(data)
    out, told = run(command, path, tmp_path, capsys)
    if command in ("cut-bus", "merge"):
        whole = GOOD * (2 if command == "merge" else 1)
        assert whole - 8 <= frames_of(out) < whole
    assert "a chunk of the log cannot be read" in told


def test_a_summary_that_is_damaged_is_not_believed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Places in the index lead past messages; the check of the summary tells."""
    path = log(tmp_path / "log.mcap")
    data = bytearray(path.read_bytes())
    start = int.from_bytes(data[-28:-20], "little")
    data[start + 40 : start + 48] = b"\x01" * 8
    path.write_bytes(data)
    out, told = run("cut-bus", path, tmp_path, capsys)
    assert frames_of(out) == GOOD
    assert "is incomplete" in told


def test_a_rate_at_which_a_few_messages_fill_the_disk_is_refused(tmp_path: Path, cli) -> None:
    path = tmp_path / "jump.txt"
    path.write_text(
        "1.0 TX: FA 01 32 2D\n1.1 RX: FB 01 32 01 40 6F\n1000000.0 TX: FA 01 32 2D\n1000000.1 RX: FB 01 32 01 40 6F\n"
    )
    assert "rows in 999999 s, expected" in cli("export", path, "--rate", "10Hz", "-o", tmp_path / "out.csv", status=2).err
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("first", ["serial", "can"])
def test_a_bus_of_another_kind_that_comes_late_is_decoded(first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "SAMPLE_ITEMS", 5)
    serial = ("/left/1/run_speed/request", 1, {"_raw": "FA 01 F6 01 40 02 34", "_offset": 0})
    can = ("/can0/1/run_speed/request", 2, {"_raw": "F6 01 40 02 3A", "_offset": 0, "_can_id": 1})
    given = [serial] * 10 + [can] if first == "serial" else [can, serial]
    path = builders.mcap_log(tmp_path / "log.mcap", [(topic, n, body) for n, (topic, _, body) in enumerate(given)])
    assert main(["decode", str(path), "-o", str(tmp_path / "out.mcap")]) == 0
    with (tmp_path / "out.mcap").open("rb") as stream:
        topics = {c.topic for _, c, _ in make_reader(stream).iter_messages()}
    assert {"/left/1/run_speed/request", "/can0/1/run_speed/request"} <= topics
