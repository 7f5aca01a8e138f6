"""The log of an emulated bus: all that went over the wire, with who sent it, whole at the end."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from analyzer import dialects
from analyzer.encoder import build
from analyzer.errors import UsageError
from conformance.drives.bus import Bus
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus
from conformance.serve.log import BusLog
from tests.conformance.drives.plain_drive import PlainDrive
from tests.conformance.drives.served import drives
from tests.logs import messages, metadata

ANCHOR_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
MKS, LK, CAN = (dialects.get(name) for name in ("mks-rs485", "lk-rs485", "mks-can"))


def log_of(bus: Bus, path: Path, *names: str) -> BusLog:
    return BusLog.of(bus, str(path), [dialects.get(n) for n in names], anchor_ns=ANCHOR_NS)


def test_requests_replies_and_times(tmp_path: Path) -> None:
    path = tmp_path / "bus.mcap"
    bus = SerialBus(drives("mks-rs485@1", "lk-rs485@2,baud=38400"))
    log = log_of(bus, path, "mks-rs485", "lk-rs485")
    for data in (build(MKS, "read_speed", 1), build(LK, "clear_turns", 2)):
        bus.send(data)
        bus.run_until(bus.now_ns + SECOND)
    log.finish({"source": "a test"})
    topics = [topic for topic, _ in messages(path) if "stats" not in topic and "state" not in topic]
    # LK replies are the requests over again; the log knows who sent them.
    assert topics == [
        "/bus/1/read_speed/request",
        "/bus/1/read_speed/reply",
        "/bus/2/clear_turns/request",
        "/bus/2/clear_turns/reply",
    ]
    with path.open("rb") as stream:
        first = next(m for _, _, m in make_reader(stream).iter_messages(topics=["/bus/1/read_speed/request"]))
    about = metadata(path)
    assert first.log_time == pytest.approx(ANCHOR_NS + 4 * 10 * SECOND / 38400, abs=1000)
    assert about["bytes_total"] == about["bytes_in_frames"] == "20"
    assert (about["frames"], about["source"], about["baud"]) == ("4", "a test", "38400")


def test_a_can_bus(tmp_path: Path) -> None:
    path = tmp_path / "bus.mcap"
    bus = CanBus(drives("mks-can@1"), name="arm", speed=500_000)
    log = log_of(bus, path, "mks-can")
    bus.send(1, build(CAN, "read_speed", 1))
    bus.send(0x123, b"\1\2\3", extended=True)
    bus.run_until(SECOND)
    log.finish({})
    topics = [topic for topic, _ in messages(path)]
    assert "/arm/1/read_speed/request" in topics
    assert "/arm/1/read_speed/reply" in topics
    assert "/arm/foreign" in topics


def test_collisions_and_speeds_are_comments(tmp_path: Path) -> None:
    path = tmp_path / "bus.mcap"
    bus = SerialBus(drives("mks-rs485@1", "mks-rs485@1"))
    log = log_of(bus, path, "mks-rs485")
    bus.speed = 9600
    bus.speed = 38400
    bus.send(build(MKS, "read_speed", 1))
    bus.run_until(SECOND)
    log.finish({})
    texts = [data["message"] for topic, data in messages(path) if topic == "/comments"]
    assert texts[0].startswith("the host is at 9600 baud, mks-rs485@1 at 38400")
    assert texts[1] == "collision: mks-rs485@1 and mks-rs485@1 send at once"


def test_silence_ends_the_wait_for_more(tmp_path: Path) -> None:
    bus = SerialBus([PlainDrive("mks-rs485", 1)])
    log = log_of(bus, tmp_path / "bus.mcap", "mks-rs485")
    bus.send(build(MKS, "read_speed", 1))
    bus.run_until(SECOND)
    assert log.summary.frames == 1
    log.tick(bus.now_ns)
    assert log.summary.frames == 2
    log.finish({})


def test_a_log_that_cannot_be_written_is_told_once(tmp_path: Path) -> None:
    bus = SerialBus([PlainDrive("mks-rs485", 1)])
    log = log_of(bus, tmp_path / "bus.mcap", "mks-rs485")
    log._stream.close()
    full = open("/dev/full", "wb", buffering=0)  # noqa: SIM115
    log._stream = log._log._file._stream = full
    bus.send(build(MKS, "read_speed", 1))
    bus.run_until(SECOND)
    with pytest.raises(UsageError, match=r"cannot write .*bus\.mcap: No space left on device"):
        log.tick(5 * SECOND)
    log.finish({})
    full.close()
