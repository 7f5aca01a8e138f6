"""Faults of the wire: at their rates, by their seed, in both directions."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus
from conformance.drives.wire_faults import KINDS, WireFaults, parse_rates
from tests.conformance.drives.plain_drive import PlainDrive

MKS = dialects.get("mks-rs485")
READ = build(MKS, "read_speed", 1)
REPLY = build(MKS, "read_speed", 1, {}, Role.REPLY)
ROUNDS = 300


def poll(faults: WireFaults | None, *, wire_time: bool = True) -> tuple[list[bytes], PlainDrive, SerialBus]:
    drive = PlainDrive("mks-rs485", 1, delay_ns=100_000)
    bus = SerialBus([drive], faults=faults, wire_time=wire_time)
    answers = []
    for _ in range(ROUNDS):
        bus.send(READ)
        bus.run_until(bus.now_ns + 200_000_000)
        answers.append(bus.received())
    return answers, drive, bus


def test_no_rate_no_fault() -> None:
    answers, _, bus = poll(WireFaults({"flip": 0.0}))
    assert answers == [REPLY] * ROUNDS
    assert bus.faults is not None
    assert bus.faults.struck == {}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("wire_time", [True, False])
def test_each_kind_strikes_both_ways_and_lets_the_rest_through(kind: str, wire_time: bool) -> None:
    rate = 0.1 if kind in ("cut", "collision") else 0.03
    faults = WireFaults({kind: rate}, seed=3)
    answers, drive, _ = poll(faults, wire_time=wire_time)
    good = answers.count(REPLY)
    assert faults.struck[kind] > 10
    assert ROUNDS * 0.5 < good <= ROUNDS
    if kind != "pause":
        assert good < ROUNDS
        assert len(drive.taken) < ROUNDS
        assert good < len(drive.taken)


def test_a_pause_holds_up_what_the_host_sends_behind_it() -> None:
    bus = SerialBus([PlainDrive("mks-rs485", 1)], faults=WireFaults({"pause": 0.2}, 1))
    for _ in range(20):
        bus.send(READ)
    bus.run_until(10_000_000_000)
    assert bus.faults is not None
    assert bus.faults.struck["pause"] > 10
    assert bus.collisions == 0


def test_the_seed_is_the_plan() -> None:
    def answers(seed: int) -> list[bytes]:
        return poll(WireFaults({"flip": 0.02, "drop": 0.02, "collision": 0.02}, seed))[0]

    assert answers(1) == answers(1)
    assert answers(1) != answers(2)


def test_one_rate_does_not_move_the_others() -> None:
    alone = WireFaults({"flip": 0.1}, 5)
    both = WireFaults({"flip": 0.1, "insert": 0.0001}, 5)
    assert [alone.on_line(bytes(20)).pieces for _ in range(20)] == [both.on_line(bytes(20)).pieces for _ in range(20)]


def test_faults_of_a_can_bus_keep_its_frames_short() -> None:
    faults = WireFaults(dict.fromkeys(KINDS, 0.2), 1)
    bus = CanBus([PlainDrive("mks-can", 1)], faults=faults)
    seen = []
    for _ in range(100):
        bus.send(1, build(dialects.get("mks-can"), "read_speed", 1))
        bus.run_until(bus.now_ns + 100_000_000)
        seen += bus.received()
    assert all(len(frame.data) <= 8 for frame in seen)
    assert all(faults.struck.values())


def test_rates_as_people_write_them() -> None:
    assert parse_rates("flip=0.001,drop=1") == {"flip": 0.001, "drop": 1.0}
    for wrong in ("flip", "flip=", "flip=x", "flip=2", "flip=-1", ""):
        with pytest.raises(UsageError, match="expected KIND=RATE"):
            parse_rates(wrong)
    with pytest.raises(UsageError, match="no wire fault 'flop'; did you mean flip"):
        WireFaults({"flop": 0.1})
    with pytest.raises(UsageError, match=r"expected 0\.\.1"):
        WireFaults({"flip": 3})
