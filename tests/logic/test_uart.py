"""UART waveforms that were made: the bytes that were sent come back at their times, with nothing told of the line."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer.errors import UnreadableError, UsageError
from analyzer.logic import uart as uart_reader
from analyzer.logic.levels import Levels
from analyzer.records import Chunk, Event
from analyzer.sources import Record, Source, open_source
from tests.contracts.source_contract import read_all
from tests.logic.waves import SECOND_NS, Wave, uart, write_sr

RATE = 1_000_000
REQUEST, REPLY = bytes.fromhex("FA 01 30 2B"), bytes.fromhex("FB 01 30 00 00 00 01 20 00 4D")


def talk(baud: float, rounds: int = 6, seven: bool = False) -> list[tuple[float, bytes]]:
    """Return requests and replies of a drive, with pauses, as (start in ns, bytes)."""
    chance, at, said = random.Random(5), 30 * SECOND_NS / baud, []
    for number in range(rounds):
        for data in (REQUEST, bytes((0xFB, 1, 0x30, 0, 0, 0, number & 255, 7 * number & 255, 31 * number & 255))):
            data = bytes(value & 0x7F for value in data) if seven else data
            said.append((at, data))
            at += (13 * len(data) + chance.uniform(4, 40)) * SECOND_NS / baud
    return said


def found(wave: Wave | list[Wave], rate: int, folder: Path, **options: object) -> tuple[Source, list[Record]]:
    return read_all(write_sr(folder / "x.sr", wave if isinstance(wave, list) else [wave], rate), **options)


def bytes_of(records: list[Record]) -> list[tuple[int, int]]:
    return [(record.t_ns or 0, record.data[0]) for record in records if isinstance(record, Chunk)]


def check(wave: Wave, sent: list[tuple[int, int]], rate: int, folder: Path, off_samples: float = 2) -> list[str]:
    source, records = found(wave, rate, folder)
    got = bytes_of(records)
    assert [value for _, value in got] == [value for _, value in sent]
    assert max(abs(a - b) for (a, _), (b, _) in zip(got, sent, strict=True)) <= off_samples * SECOND_NS / rate
    return source.notes


@pytest.mark.parametrize("per_bit", [4, 5.3, 8, 50])
@pytest.mark.parametrize("form", ["8N1", "8E1", "8O1", "8N2", "7E1"])
@pytest.mark.parametrize(("baud", "drift", "inverted"), [(9600, 0.0, False), (115200, 0.02, True), (333_000, -0.02, False)])
def test_formats_rates_and_drift(form: str, per_bit: float, baud: int, drift: float, inverted: bool, tmp_path: Path) -> None:
    wave, sent = uart(talk(baud, seven=form[0] == "7"), baud * (1 + drift), form)
    notes = check(wave.inverted() if inverted else wave, sent, round(baud * per_bit), tmp_path)
    assert form[:2] in notes[0]
    assert ("inverted" in notes[0]) == inverted


@pytest.mark.parametrize("seed", range(4))
def test_jitter_and_glitches(seed: int, tmp_path: Path) -> None:
    wave, sent = uart(talk(38400, rounds=20), 38400)
    bit = SECOND_NS / 38400
    notes = check(wave.disturbed(0.12 * bit, 12, 0.15 * bit, seed), sent, 16 * 38400, tmp_path, off_samples=5)
    assert not any("doubtful" in note for note in notes)


@settings(max_examples=8, deadline=None)
@given(data=st.binary(min_size=12, max_size=80), baud=st.integers(300, 3_000_000), per_bit=st.floats(4, 40))
def test_any_bytes_at_any_rate(data: bytes, baud: int, per_bit: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    # Of a few different bytes a UART can make a wave that another one makes, too.
    data = b"\xfa\x01\x30\x2b" + data
    at = 30 * SECOND_NS / baud
    wave, sent = uart([(at, data[:9]), (at + 120 * SECOND_NS / baud, data[9:])], baud)
    source, records = found(wave, round(baud * per_bit), tmp_path_factory.mktemp("wave"))
    got = [value for _, value in bytes_of(records)]
    assert got in ([value for _, value in sent], [value & 0x7F for _, value in sent]), source.notes


def test_of_a_long_capture_some_stretches_tell_the_rate(tmp_path: Path) -> None:
    wave, sent = uart(talk(115200, rounds=400), 115200)
    assert len(wave.edges) > 3 * 4000
    check(wave, sent, RATE, tmp_path)


def test_wrong_stop_bits_are_counted_and_their_bytes_kept(tmp_path: Path) -> None:
    wave, sent = uart(talk(38400), 38400, wrong_stops=(3, 50))
    source, records = found(wave, RATE, tmp_path)
    assert [value for _, value in bytes_of(records)] == [value for _, value in sent]
    assert [event.values for event in records if isinstance(event, Event)] == [{"frame": 1}, {"frame": 1}]
    assert "2 bytes with a parity or framing error" in source.notes


def test_a_doubtful_bit_marks_its_byte(tmp_path: Path) -> None:
    wave, sent = uart(talk(9600), 9600)
    bit = SECOND_NS / 9600
    # A glitch in the middle of data bit 7 of the fourth byte, which is as long as the rest of that bit's middle.
    at = sent[3][0] - 1.7 * bit
    wave.edges = sorted([*wave.edges, at, at + 0.35 * bit])
    source, records = found(wave, RATE, tmp_path)
    assert [value for _, value in bytes_of(records)][4:] == [value for _, value in sent][4:]
    (event,) = [record for record in records if isinstance(record, Event)]
    assert event.values == {"doubtful": 1}
    assert abs(event.t_ns - sent[3][0]) < 5_000
    assert any("1 byte with a doubtful bit, which may be wrong" in note for note in source.notes)


@pytest.mark.parametrize(
    ("jitter", "glitches", "glitch", "least"),
    [(0.3, 0, 0.0, 0.8), (0.4, 0, 0.0, 0.8), (0.0, 200, 0.4, 0.95), (0.1, 200, 0.4, 0.95)],
)
def test_most_bytes_that_are_read_wrong_are_marked(jitter: float, glitches: int, glitch: float, least: float) -> None:
    bit = SECOND_NS / 38400
    wave, sent = uart(talk(38400, rounds=60), 38400)
    spoiled = wave.disturbed(jitter * bit, glitches, glitch * bit, seed=3)
    edges = np.array(spoiled.edges).astype(np.int64)
    read = uart_reader.read(Levels(spoiled.first, edges, 0, int(spoiled.end_ns)), uart_reader.Format(bit))
    marked = read.doubtful | read.bad_stop | read.bad_parity
    values = dict(sent)
    times = np.array(list(values))
    nearest = times[np.abs(times[:, None] - read.ends).argmin(axis=0)]
    right = (np.abs(nearest - read.ends) < 0.6 * bit) & (read.values == [values[t] for t in nearest.tolist()])
    assert (~right).sum() > 20
    assert marked[~right].mean() >= least


@pytest.mark.parametrize("form", ["8N1", "8E1", "8N2"])
@pytest.mark.parametrize("share", [0, 0.1])
def test_text_is_no_can(form: str, share: float, tmp_path: Path) -> None:
    # Rows that begin alike look like the heads of CAN FD at another rate.
    chance, rows = random.Random(7), []
    for number in range(40):
        rows.append((1e6 + number * 12e6, b"Speed=%d rpm pos=%d\r\n" % (chance.randrange(3000), chance.randrange(10**6))))
    wrong = [number for number in range(1000) if chance.random() < share]
    wave, sent = uart(rows, 38400, form, wrong_stops=wrong)
    check(wave, sent, 384_000, tmp_path)


@pytest.mark.parametrize(("low", "high"), [(0.33, 0.17), (0.2, 0.2)])
def test_a_start_bit_with_a_glitch_in_it(low: float, high: float, tmp_path: Path) -> None:
    wave, sent = uart(talk(9600), 9600)
    bit = SECOND_NS / 9600
    start = wave.edges[0]
    wave.edges[1:1] = [start + low * bit, start + (low + high) * bit]
    check(wave, sent, 40 * 9600, tmp_path)


def test_a_format_that_is_given_is_taken(tmp_path: Path) -> None:
    # Few bytes do not tell a parity from a bit, nor from a second stop bit.
    wave, sent = uart([(1e6, b"\x03\x07\x11")], 9600, "7E1")
    _, records = found(wave, 160_000, tmp_path, uart="7E1", baud=9600)
    assert [value for _, value in bytes_of(records)] == [value for _, value in sent]
    _, records = found(wave, 160_000, tmp_path, uart="8N1", baud=9600)
    assert [value for _, value in bytes_of(records)] == [0x03, 0x87, 0x11]


def test_a_byte_that_the_end_cuts_is_left_out(tmp_path: Path) -> None:
    wave, sent = uart(talk(9600), 9600, tail_ns=0)
    wave.end_ns -= 4.5 * SECOND_NS / 9600
    wave.edges = [t for t in wave.edges if t < wave.end_ns]
    assert [value for _, value in bytes_of(found(wave, RATE, tmp_path)[1])] == [value for _, value in sent[:-1]]


# --- several channels ---------------------------------------------------------------------------------------------------

BOTH = sorted([(1e6 + n * 6e6, REQUEST) for n in range(8)] + [(4e6 + n * 6e6, REPLY) for n in range(8)])
BUS = uart(BOTH, 38400, name="bus")[0]


def side(data: bytes, name: str) -> Wave:
    return uart([row for row in BOTH if row[1] == data], 38400, name=name)[0]


def test_two_sides_have_directions_where_their_names_say_so(tmp_path: Path) -> None:
    _, records = found([side(REQUEST, "TX"), side(REPLY, "RX")], RATE, tmp_path)
    directions = [(record.direction.value, record.port) for record in records if isinstance(record, Chunk)]
    assert directions == ([("request", "serial")] * 4 + [("reply", "serial")] * 10) * 8
    _, records = found([side(REQUEST, "D0"), side(REPLY, "D1")], RATE, tmp_path)
    assert b"".join(record.data for record in records if isinstance(record, Chunk)) == (REQUEST + REPLY) * 8


def test_a_differential_pair_is_one_line(tmp_path: Path) -> None:
    for waves in ([BUS.inverted("B"), BUS], [BUS, BUS.inverted("B")]):
        source, records = found(waves, RATE, tmp_path)
        assert len(bytes_of(records)) == 14 * 8
        assert any("differential pair: bus is read" in note for note in source.notes)
    assert bytes_of(found(BUS.inverted("B"), RATE, tmp_path)[1]) == bytes_of(records)


def test_what_is_a_part_of_the_bus_is_not_read_twice(tmp_path: Path) -> None:
    source, records = found([side(REQUEST, "TX"), BUS], RATE, tmp_path)
    assert len(bytes_of(records)) == 14 * 8
    assert "all of TX is on bus, too: only the latter is read" in source.notes


def test_two_buses_are_two_ports(tmp_path: Path) -> None:
    other = uart([(t + 1.4e6, data) for t, data in BOTH], 115200, name="left")[0]
    _, records = found([BUS, other], RATE, tmp_path)
    assert {record.port for record in records} == {"bus", "left"}
    times = [record.t_ns or 0 for record in records]
    assert times == sorted(times)
    _, records = found([BUS, other], RATE, tmp_path, channels=["LEFT"])
    assert {record.port for record in records} == {"serial"}


def test_other_signals_are_not_taken_for_traffic(tmp_path: Path) -> None:
    clock, random_bits, chance = Wave("CLK"), Wave("MOSI"), random.Random(1)
    for _ in range(2000):
        clock.hold(0, 10e3)
        clock.hold(1, 10e3)
        random_bits.hold(chance.getrandbits(1), 4e3)
    source, records = found([clock, BUS, random_bits], RATE, tmp_path)
    assert len(bytes_of(records)) == 14 * 8
    assert any(note.startswith("CLK may carry traffic, too") and "--channel CLK" in note for note in source.notes)


@pytest.mark.parametrize(
    ("waves", "rate", "options", "error"),
    [
        ([Wave("A", 1, [], 1e7), Wave("B", 0, [], 1e7)], RATE, {}, r"no traffic on any of its 2 channels \(A, B\)"),
        (
            [Wave("A", 1, [], 1e7), BUS],
            RATE,
            {"channels": ["A"]},
            "no traffic on channel A; there are edges on bus: .*--channel",
        ),
        ([BUS], 80_000, {}, "too few samples for a bit, at least 4 are needed on bus"),
    ],
)
def test_what_cannot_be_read_is_said(
    waves: list[Wave], rate: int, options: dict[str, object], error: str, tmp_path: Path
) -> None:
    with pytest.raises(UnreadableError, match=error):
        found(waves, rate, tmp_path, **options)


def test_a_channel_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has no channel 'buss'; did you mean bus"):
        found(BUS, RATE, tmp_path, channels=["buss"])
    (tmp_path / "x.log").write_text("FA 01 30 2B\n" * 3)
    with pytest.raises(UsageError, match="hex text, without levels: --channel, --inverted and --uart"):
        open_source(tmp_path / "x.log", channels=["bus"])


def test_a_rate_that_is_given_is_taken(tmp_path: Path) -> None:
    source, records = found(BUS, RATE, tmp_path, baud=38400)
    assert len(bytes_of(records)) == 14 * 8
    source, records = found(BUS, RATE, tmp_path, baud=9600)
    assert any("framing error: is that the rate?" in note for note in source.notes)
