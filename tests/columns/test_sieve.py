"""`servotap show --filter` prints the same, whether a capture goes by blocks or frame by frame; logs are read the same, too."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.cli import main, show
from analyzer.cli.filter import Kind, Meaning, vocabulary
from analyzer.columns.block import CanBlock
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.sinks.mcap_log import McapLog
from analyzer.sources import open_source
from tests.columns.both_ways import short_runs
from tests.columns.can_traffic import frames
from tests.columns.serial_traffic import POLLS, chunks_of, polls

SIGNS = ("==", "!=", "<", "<=", ">", ">=")
SIMPLE = ("address", "time", "latency", "offset", "sequence", "raw", "findings", "checksum_ok", "section", "bus", "dialect")


def log(path: Path, name: str, seed: int) -> Path:
    """Write a log of traffic in which little, or much, is odd."""
    chance = random.Random(seed)
    dialect = dialects.get(name)
    with path.open("wb") as stream:
        sink = McapLog(stream, bit_ns=2000)
        pipeline = Pipeline([dialect], [sink], Options())
        if dialect.bus == "can":
            pipeline.run(frames(dialect, chance, 1200, 0.1, chance.choice((0.01, 0.1))))
        else:
            line = b"".join(row.data for row in polls(name, chance, 1200))
            cut = chance.randrange(len(line))
            pipeline.run(chunks_of(line[:cut] + b"\x00\x81" + line[cut:], chance, steady=True))
        sink.finish({})
    return path


def filters(known: dict[str, Meaning], chance: random.Random, count: int) -> list[str]:
    """Return expressions over names that occur, of which some are nonsense: these are refused alike."""
    fields = [name for name, meaning in known.items() if name not in SIMPLE and meaning.kind is Kind.NUMBER]

    def value(name: str) -> str:
        meaning = known[name]
        if meaning.words and chance.random() < 0.8:
            return repr(chance.choice(sorted(meaning.words)))
        low, high = meaning.low or 0, meaning.high or 2000
        return str(chance.choice((0, 1, low, high, round(chance.uniform(max(low, -1e6), min(high, 1e6)), 2))))

    def condition(depth: int) -> str:
        kind = chance.random()
        if depth and kind < 0.5:
            return f"({condition(depth - 1)} {chance.choice(('and', 'or'))} {condition(depth - 1)})"
        if depth and kind < 0.6:
            return f"not {condition(depth - 1)}"
        name = chance.choice((*SIMPLE, "command", "role", *chance.sample(fields, 6)))
        if kind < 0.65:
            return chance.choice((name, f"{name} % 7 == 3", f"'0' in {name}", f"{name} + address > 9", "latency > 0.2ms"))
        if kind < 0.75:
            return f"{name} in [{value(name)}, {value(name)}]"
        return f"{name} {chance.choice(SIGNS)} {value(name)}"

    return [condition(3) for _ in range(count)]


def shown(path: Path, words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[object, ...]:
    """Return what is printed."""
    status = main(["show", str(path), *words])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["mks-can", *POLLS])
def test_the_same_is_shown(name, seed, tmp_path, capsys, monkeypatch):
    path = log(tmp_path / "log.mcap", name, seed)
    chance = random.Random(seed)
    vague = 'role == "reply" and latency > 0.1'
    wanted = [vague, *filters(vocabulary([dialects.get(name)]), chance, 12)]
    asked = [["--dialect", name], *(["--dialect", name, "--filter", text] for text in wanted)]
    asked += [["--dialect", name, "--json", "--filter", vague, "--limit", "20"]]
    monkeypatch.setattr(show, "LONG_CAPTURE", 1 << 40)
    single = [shown(path, words, capsys) for words in asked]
    monkeypatch.setattr(show, "LONG_CAPTURE", 0)
    taken = []
    run = show.Table.run
    monkeypatch.setattr(show.Table, "run", lambda self, *rows: (taken.append(rows), run(self, *rows)))
    with short_runs():
        for words, expected in zip(asked, single, strict=True):
            assert shown(path, words, capsys) == expected, words
    assert len({result[1] for result in single}) > 3
    assert taken


def test_one_message_answers_for_all():
    from analyzer.cli.filter import Filter

    known = vocabulary([dialects.get("mks-can")])
    names = {"command": "read_speed", "address": 1, "role": "reply", "dialect": "mks-can", "speed": 7}
    cases = {
        'command == "enable"': False,
        'command == "read_speed"': True,
        'command == "enable" and speed > 300': False,
        'command == "read_speed" or speed > 300': True,
        'command == "read_speed" and speed > 300': None,
        'speed > 300 and command == "enable"': None,
        "acceleration > 3": False,
        "not latency > 3ms": None,
    }
    for text, answer in cases.items():
        assert Filter(text, known).settled(names, {"speed", "latency"}) is answer, text


def records_of(path: Path, *, in_blocks: bool) -> tuple[list[object], list[str], list[object], int]:
    """Return the records of a log, its notes and problems, and how many came in blocks."""
    with open_source(path) as source:
        source.in_blocks = in_blocks
        got: list[object] = []
        together = 0
        try:
            for item in source.items():
                whole = isinstance(item, CanBlock)
                together += len(item) if whole else 0
                got += item.frames() if whole else [item]
        except Exception as error:
            got.append(str(error))
        return got, source.notes, source.problems, together


@pytest.mark.parametrize("seed", range(4))
def test_a_log_is_read_the_same(seed, tmp_path):
    path = log(tmp_path / "log.mcap", "mks-can", seed)
    *single, _ = records_of(path, in_blocks=False)
    with short_runs():
        *together, count = records_of(path, in_blocks=True)
    assert together == single
    assert count > 500


@pytest.mark.parametrize("seed", range(6))
def test_a_damaged_log_is_read_the_same(seed, tmp_path):
    """Uncompressed, without checks: so damage is in the messages themselves."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    chance = random.Random(seed)
    whole = log(tmp_path / "whole.mcap", "mks-can", seed)
    path = tmp_path / "log.mcap"
    with whole.open("rb") as stream, path.open("wb") as out:
        writer = Writer(out, compression=CompressionType.NONE, enable_crcs=False, chunk_size=1 << 16)
        writer.start("servotap")
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "json", number, channel.metadata)
            data = message.data
            if chance.random() < 0.01:
                at = chance.randrange(len(data))
                data = chance.choice(
                    (data[:at], data[:at] + b"," + data[at:], data.replace(b" ", b"", 1), data.replace(b'":"', b'":"0', 1),
                     data.replace(b'"_can_id":', b'"_can_id":-'), data.replace(b'"_raw":"', b'"_raw":" '), data.lower())
                )  # fmt: skip
            log_ns = message.log_time - chance.choice((0, 0, 5_000_000_000)) * (chance.random() < 0.01)
            writer.add_message(channels[channel.topic], log_ns, data, message.publish_time, message.sequence)
        writer.finish()
    *single, _ = records_of(path, in_blocks=False)
    with short_runs():
        *together, count = records_of(path, in_blocks=True)
    assert together == single
    assert single[2]
    assert count > 200
