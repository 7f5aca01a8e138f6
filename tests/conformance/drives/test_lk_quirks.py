"""Each quirk of the LK drive: off by default, and what it does when it is on, beside frames of a real log."""

from __future__ import annotations

from collections import Counter

import pytest

from analyzer.link import sum8
from conformance.drives.drive import Quirk
from conformance.drives.lk.quirks import QUIRKS
from tests.conformance.drives.lk_bench import Bench

NAMED = {quirk.name: quirk for quirk in QUIRKS}


def bench_with(name: str, **options: object) -> Bench:
    return Bench(quirks=(NAMED[name],), **options)


@pytest.mark.parametrize("quirk", QUIRKS, ids=lambda q: q.name)
def test_quirk_says_what_it_is_and_where_it_was_seen(quirk: Quirk) -> None:
    assert quirk.name.startswith("lk-")
    assert "_" not in quirk.name
    assert quirk.dialects == ("lk-rs485",)
    assert quirk.text
    assert quirk.source


def test_names_are_unique() -> None:
    assert len(NAMED) == len(QUIRKS) >= 6


def off_sums(bench: Bench, count: int = 2000) -> list[int]:
    result = []
    for number in range(count):
        (reply,) = bench.ask("move_multi_turn_limited", position=number, max_speed=10_000)
        assert reply.data[4] == sum8(reply.data[:4])
        result.append((reply.data[-1] - sum8(reply.data[5:-1]) + 128) % 256 - 128)
    return result


def test_off_sum() -> None:
    assert not any(off_sums(Bench(), 200))
    found = off_sums(bench_with("lk-off-sum", seed=3))
    wrong = [off for off in found if off]
    assert 8 <= len(wrong) <= 40  # 1 %
    assert set(map(abs, wrong)) <= {1, 2, 3, 4}
    assert len(Counter(wrong)) > 2
    assert off_sums(bench_with("lk-off-sum", seed=3)) == found
    assert off_sums(bench_with("lk-off-sum", seed=4)) != found
    bench = bench_with("lk-off-sum")
    for _ in range(500):
        (reply,) = bench.ask("read_state_2")
        assert reply.data[-1] == sum8(reply.data[5:-1])


@pytest.mark.parametrize("command", ["move_multi_turn_limited", "move_single_turn_limited", "move_increment_limited"])
def test_zero_speed_moves(command: str) -> None:
    name, values = ("angle", {"direction": 0}) if "single" in command else ("position", {})
    for bench, end in ((Bench(), 0), (bench_with("lk-zero-speed-moves"), 30_000)):
        bench.ask(command, max_speed=0, **{name: 30_000}, **values)
        bench.wait(0.3)
        if end:
            assert bench.speed() == 720  # within what was seen, 600 to 800 deg/s
        bench.wait(2)
        assert bench.position() == end


def test_off_clears_turns() -> None:
    for bench, left in ((Bench(), 100_000), (bench_with("lk-off-clears-turns"), 28_000)):
        bench.ask("move_multi_turn", position=100_000)
        bench.wait(3)
        bench.ask("motor_off")
        assert bench.position() == left


def test_reply_within() -> None:
    bench = bench_with("lk-reply-within", seed=1)
    delays = [bench.ask("read_state_2")[0].at_ns - bench.t_ns + 1_000_000 for _ in range(200)]
    assert 50_000 <= min(delays) < 70_000
    assert 230_000 < max(delays) <= 250_000


def test_encoder_wide_difference() -> None:
    settings = {"encoder_bits": 14, "encoder_zero": 1244}
    plain, odd = Bench(settings=settings), bench_with("lk-encoder-wide-difference", settings=settings)
    shown = [bench.read("read_encoder")["encoder"] for bench in (plain, odd)]
    assert shown == [(1 << 14) - 1244, (1 << 16) - 1244]


def test_firmware_235_answers_what_a_real_one_was_sent() -> None:
    """The requests of a real log; what the drive measures differs, what it is and holds does not."""
    bench = bench_with("lk-firmware-235", model="MS")
    (product,) = bench.send(bytes.fromhex("3E 12 01 00 51"))
    assert product.data[:11] == bytes.fromhex("3E 12 01 3A 8B 44 53 34 30 52 37")
    assert len(product.data) == 64
    assert product.data[-7:-1] == bytes.fromhex("2C 01 C8 00 EB 00")
    for request, reply in (
        ("3E 88 01 00 C7", "3E 88 01 00 C7"),
        ("3E 42 01 07 88 97 32 00 14 00 00 00 DD", "3E 42 01 02 83 97 00 97"),
        ("3E 42 01 07 88 96 32 00 14 00 00 00 DC", "3E 42 01 02 83 96 00 96"),
        ("3E 40 01 02 81 00 96 96", "3E 40 01 07 86 96 32 00 14 00 00 00 DC"),
    ):
        assert [o.data.hex(" ").upper() for o in bench.send(bytes.fromhex(request))] == [reply]
    assert bench.drive.parameters["speed_kp"] == 0x32
    assert bench.ask("read_parameter", parameter=10) == []
    assert bench.ask("write_parameter", parameter=10) == []
    assert bench.send(bytes.fromhex("3E 07 01 00 46")) == []  # restart
    assert bench.drive.parameters["speed_ki"] == 20
    assert bench.drive.parameters == bench_with("lk-firmware-235", model="MS").drive.parameters
    (refused,) = bench.send(bytes.fromhex("3E 42 01 07 88 11 00 00 00 00 00 00 11"))
    assert refused.data == bytes.fromhex("3E 42 01 02 83 11 01 12")


def test_firmware_235_sets_limits() -> None:
    bench = bench_with("lk-firmware-235", model="MS")
    bench.send(bytes.fromhex("3E 42 01 07 88 9A 28 23 00 00 00 00 E5"))
    bench.ask("run_speed", speed=50_000)
    bench.wait(1)
    assert bench.speed() == 90


def test_without_the_quirk_its_codes_meet_silence() -> None:
    bench = Bench(model="MS")
    for text in ("3E 12 01 00 51", "3E 40 01 02 81 00 96 96", "3E 07 01 00 46"):
        assert bench.send(bytes.fromhex(text)) == []


def test_a_conforming_drive_keeps_what_real_ones_were_seen_to_do_as_well() -> None:
    bench = Bench(model="MS", settings={"encoder_zero": 1244})
    for name in ("motor_off", "motor_on"):
        (reply,) = bench.ask(name)
        assert reply.data == bench.request(name)
    encoder = bench.read("read_encoder")
    assert encoder["encoder"] == (encoder["encoder_raw"] - encoder["encoder_offset"]) % 65536
    assert bench.read("read_state_2")["encoder"] == encoder["encoder"]
    bench.ask("run_speed", speed=1000)
    at = bench.position()
    bench.wait(1)
    assert bench.position() > at  # clockwise counts up
