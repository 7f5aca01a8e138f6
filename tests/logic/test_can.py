"""CAN waveforms that were made: frames come back with their CRC checked, and destroyed ones as error frames."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer.columns.codec import Integers
from analyzer.errors import UnreadableError
from analyzer.logic import can as receiver
from analyzer.logic.levels import Levels
from analyzer.records import CanFrame
from analyzer.sources import Source
from tests.contracts.source_contract import read_all
from tests.logic.waves import SECOND_NS, Wave, can, can_bits, crc15, write_sr

STATE = bytes.fromhex("31 00 00 00 01 2C 60")


def frames(wave: Wave | list[Wave], rate: int, folder: Path) -> tuple[Source, list[CanFrame]]:
    waves = wave if isinstance(wave, list) else [wave]
    source, records = read_all(write_sr(folder / "x.sr", waves, rate))
    return source, [record for record in records if isinstance(record, CanFrame)]


def levels_of(wave: Wave) -> Levels:
    import numpy as np

    edges: Integers = np.array(wave.edges).astype(np.int64)
    return Levels(wave.first, edges, 0, int(wave.end_ns))


def test_the_crc_is_that_of_the_standard() -> None:
    chance = random.Random(2)
    for count in range(1, 90):
        bits = [chance.getrandbits(1) for _ in range(count)]
        assert receiver.crc15(int("".join(map(str, bits)), 2), count) == crc15(bits)


FRAME = st.builds(
    lambda extended, number, data, remote: (extended, number if extended else number & 0x7FF, data, remote),
    st.booleans(),
    st.integers(0, 0x1FFF_FFFF),
    st.binary(max_size=8) | st.integers(0, 8).map(lambda n: b"\xff" * n) | st.integers(0, 8).map(bytes),
    st.booleans(),
)


@settings(max_examples=100, deadline=None)
@given(frame=FRAME)
def test_any_frame_with_its_stuff_bits(frame: tuple[bool, int, bytes, bool]) -> None:
    extended, number, data, remote = frame
    wave, ends = can([(20_000, can_bits(number, data, extended=extended, remote=remote))], 1_000_000)
    (seen,) = receiver.read(levels_of(wave), 1000.0).frames
    assert (seen.id, seen.data, seen.extended, seen.remote, seen.error, seen.t_ns) == (
        number, b"" if remote else data, extended, remote, False, ends[0],
    )  # fmt: skip


@pytest.mark.parametrize("per_bit", [4, 5.3, 10, 40])
@pytest.mark.parametrize(("rate", "drift", "inverted"), [(125_000, 0.0, False), (500_000, 0.01, True), (93_000, -0.01, False)])
def test_rates_polarity_and_drift(rate: int, drift: float, inverted: bool, per_bit: float, tmp_path: Path) -> None:
    chance = random.Random(rate)
    sent = [(chance.getrandbits(11), chance.randbytes(chance.randint(0, 8))) for _ in range(30)]
    bit = SECOND_NS / rate
    wave, ends = can([(160 * n * bit, can_bits(*frame)) for n, frame in enumerate(sent)], rate * (1 + drift))
    source, got = frames(wave.inverted() if inverted else wave, round(rate * per_bit), tmp_path)
    assert [(frame.id, frame.data) for frame in got] == sent
    assert source.kind == "can"
    off = max(abs((frame.t_ns or 0) - end) for frame, end in zip(got, ends, strict=True))
    assert off <= 3 * SECOND_NS / (rate * per_bit)


def test_jitter_glitches_and_nodes_whose_clocks_differ(tmp_path: Path) -> None:
    wave = Wave()
    sent = []
    for number in range(40):
        # Each second frame comes from a node that is 0.8 % faster.
        bit = 2000 * (0.992 if number % 2 else 1)
        wave.hold(1, 40_000)
        for level in can_bits(number, STATE):
            wave.hold(level, bit)
        sent.append(number)
    wave.hold(1, 60_000)
    _, got = frames(wave.disturbed(160, 10, 300), 8_000_000, tmp_path)
    assert [frame.id for frame in got] == sent


def test_destroyed_frames_become_error_frames(tmp_path: Path) -> None:
    good = can_bits(1, STATE)
    flag = [0] * 6 + [1] * 11
    # Without stuff bits up to there, a data bit is another one.
    wrong_crc = can_bits(0x2AA, b"\x55" * 8)
    wrong_crc[30] ^= 1
    rows = [good, good[:40] + flag, can_bits(1, b"\x30\x31", acknowledged=False)[:-8] + flag, wrong_crc, good]
    wave, _ = can([(n * 400_000, bits) for n, bits in enumerate(rows)], 500_000)
    _, got = frames(wave, 8_000_000, tmp_path)
    assert [frame.error for frame in got] == [False, True, True, True, False]
    told = [(frame.id, frame.data[2], frame.data[3]) for frame in got if frame.error]
    assert told == [(0x88, 0x04, 0), (0xA0, 0, 0), (0x88, 0x02, 0x08)]


def test_frames_without_an_acknowledge_on_a_tx_pin(tmp_path: Path) -> None:
    wave, _ = can([(n * 400_000, can_bits(n, STATE, acknowledged=False)) for n in range(10)], 500_000, name="TX")
    source, got = frames(wave, 8_000_000, tmp_path)
    assert [frame.id for frame in got] == list(range(10))
    assert "TX: no frame is acknowledged: it may be the TX pin of a controller; probe its RX pin" in source.notes


def test_either_line_of_a_pair_is_enough(tmp_path: Path) -> None:
    low, _ = can([(n * 400_000, can_bits(n, STATE)) for n in range(10)], 500_000, name="CANL")
    for waves in ([low], [low.inverted("CANH")], [low.inverted("CANH"), low]):
        assert [frame.id for frame in frames(waves, 4_000_000, tmp_path)[1]] == list(range(10))


def test_can_fd_is_said_and_not_read(tmp_path: Path) -> None:
    chance = random.Random(3)
    rows = [can_bits(n, STATE) for n in range(4)]
    for _ in range(20):
        # SOF, identifier, RRS, IDE, FDF, res; then something with no six equal bits.
        head = [0, 0, 1, 0, 1, 1, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0]
        rows.append(head + [bit for _ in range(60) for bit in (chance.getrandbits(1), 0, 1)] + [1, 0, 1] + [1] * 7)
    wave, _ = can([(n * 600_000, bits) for n, bits in enumerate(rows)], 500_000)
    source, got = frames(wave, 8_000_000, tmp_path)
    assert [frame.id for frame in got] == list(range(4))
    assert any("20 CAN FD frames passed over, the first at 0.0024" in note for note in source.notes)
    wave, _ = can([(n * 600_000, bits) for n, bits in enumerate(rows[4:])], 500_000)
    with pytest.raises(UnreadableError, match="only CAN FD frames"):
        frames(wave, 8_000_000, tmp_path)
