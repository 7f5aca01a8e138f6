"""Drives on python-can interfaces: in this process, between processes, and behind adapters on pseudo-terminals."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Iterator
from typing import Any

import can
import pytest
from can.interfaces.virtual import VirtualBus

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from conformance.bus import python_can
from conformance.bus.python_can import LibraryPort
from conformance.drives.can_bus import CanBus
from conformance.serve.can import parse_endpoint
from conformance.serve.pty import PtyPort
from tests.conformance.drives.plain_drive import PlainDrive
from tests.conformance.drives.served import Bridge, Emulated, drives, on_can, wait_for

MKS = dialects.get("mks-can")
READ = build(MKS, "read_speed", 1)
REPLY = build(MKS, "read_speed", 1, {}, Role.REPLY)
#: A group and a port of our own, so that tests that run at the same time do not meet.
GROUP = "239.74.163.99"


def frame(can_id: int, data: bytes, **options: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, **{"is_extended_id": False} | options)


def answers(bus: can.BusABC, timeout: float = 1.0, own: bytes = b"") -> list[tuple[int, bytes]]:
    """Return the frames that come until none comes for a while; `own`: what this end sent and gets back."""
    found = []
    message = bus.recv(timeout)
    while message is not None:
        data = bytes(message.data)
        if data == own:
            own = b""
        else:
            found.append((message.arbitration_id, data))
        message = bus.recv(0.15)
    return found


@pytest.fixture
def channel() -> str:
    return f"test {uuid.uuid4()}"


def on_virtual(channel: str, bus: CanBus) -> Any:
    return on_can(bus, LibraryPort("virtual", channel))


def test_virtual(channel: str) -> None:
    with on_virtual(channel, CanBus(drives("mks-can@1", "mks-can@2"))), can.Bus(channel, "virtual") as host:
        for address in (1, 2):
            host.send(frame(address, build(MKS, "read_speed", address)))
            assert answers(host) == [(address, build(MKS, "read_speed", address, {}, Role.REPLY))]
        host.send(frame(3, build(MKS, "read_speed", 3)))
        assert answers(host, 0.1) == []


def test_what_is_no_plain_frame_is_ignored(channel: str) -> None:
    drive = PlainDrive("mks-can", 1)
    with on_virtual(channel, CanBus([drive])), can.Bus(channel, "virtual") as host:
        host.send(frame(1, READ, is_extended_id=True))
        host.send(frame(1, b"", is_remote_frame=True))
        host.send(frame(1, READ, is_fd=True))
        host.send(frame(1, b"", is_error_frame=True))
        host.send(frame(1, READ))
        assert answers(host) == [(1, REPLY)]
    assert [f.data for f in drive.heard] == [READ]


def test_slcan_over_a_pair_of_terminals() -> None:
    bridge = Bridge()
    try:
        options = {"sleep_after_open": 0, "bitrate": 500000}
        with can.Bus(bridge.paths[0], "slcan", **options) as host:
            port = LibraryPort("slcan", bridge.paths[1], **options)
            with on_can(CanBus(drives("mks-can@1"), speed=port.bitrate), port):
                host.send(frame(1, READ))
                assert answers(host) == [(1, REPLY)]
    finally:
        bridge.close()


def test_an_interface_that_does_not_wait_takes_no_whole_core(channel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr(VirtualBus, "recv", lambda self, timeout=None: None)
    monkeypatch.setattr(python_can.time, "sleep", slept.append)
    port = LibraryPort("virtual", channel)
    assert port.receive(50_000_000) is None
    assert port.receive(200_000) is None
    assert port.receive(0) is None
    assert slept == [0.001, 0.0002]
    port.close()


def test_what_an_adapter_says_that_cannot_be_read_is_counted_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.closing(PtyPort()) as terminal:
        port = LibraryPort("slcan", terminal.path, sleep_after_open=0)
        good = b"t0013" + REPLY[:3].hex().encode() + b"\r"
        # No identifier, no text (which python-can would keep, and fail with for good), a payload that breaks off.
        said = [b"tXY83\r", b"\xff\x1b\r", good, b"t001801\r", good]
        terminal.write(b"".join(said))
        got: list[bytes] = []

        def heard_both() -> bool:
            frame = port.receive(10_000_000)
            got.extend([] if frame is None else [frame.data])
            return len(got) == 2

        assert wait_for(heard_both), got
        assert got == [REPLY[:3]] * 2
        assert port.unread == 3
        assert capsys.readouterr().err.count("\n") == 1
        port.close()
        port.close()
    assert "said 3 things that cannot be read, the last: a frame of length 8 has 1 bytes" in capsys.readouterr().err


def test_serial_over_a_pair_of_terminals() -> None:
    bridge = Bridge()
    try:
        host = can.Bus(bridge.paths[0], "serial")
        with host, on_can(CanBus(drives("mks-can@1")), LibraryPort("serial", bridge.paths[1])):
            host.send(frame(1, READ))
            assert answers(host) == [(1, REPLY)]
    finally:
        bridge.close()


@pytest.fixture
def multicast() -> Iterator[tuple[str, Any]]:
    """Yield the endpoint of a multicast bus and this process's end of it."""
    port = 20000 + uuid.uuid4().int % 30000
    try:
        host = can.Bus(GROUP, "udp_multicast", port=port)
        host.send(frame(0x7FF, b"\0"))
        back = host.recv(2)
    except Exception as error:
        pytest.skip(f"udp_multicast does not open here: {error}")
    if back is None:
        host.shutdown()
        pytest.skip("udp_multicast does not carry frames here")
    yield f"udp_multicast:{GROUP},port={port},bitrate=500000", host
    host.shutdown()


def test_udp_multicast_between_processes(multicast: tuple[str, Any]) -> None:
    endpoint, host = multicast
    with Emulated("mks-can@1", "mks-can@2", "--can", endpoint, "--set", "work_mode=bus_closed") as emulated:
        assert emulated.place == f"udp_multicast:{GROUP}"
        for address in (1, 2):
            request = build(MKS, "read_speed", address)
            host.send(frame(address, request))
            assert answers(host, own=request) == [(address, build(MKS, "read_speed", address, {}, Role.REPLY))]
        # A calibration answers `80 00 ..`, the very bytes of its request: taken for one, it would never end.
        request = build(MKS, "calibrate", 1)
        host.send(frame(1, request))
        assert answers(host, own=request) == [(1, request)]
        assert emulated.end() == (0, "")


@pytest.mark.parametrize("hands_back", [True, False])
def test_own_frames_that_come_back_are_no_requests(channel: str, hands_back: bool) -> None:
    drive = PlainDrive("mks-can", 1)
    port = LibraryPort("virtual", channel, receive_own_messages=hands_back)
    with on_can(CanBus([drive]), port), can.Bus(channel, "virtual") as host:
        host.send(frame(1, build(MKS, "calibrate", 1)))
        assert [data for _, data in answers(host)] == [build(MKS, "calibrate", 1, {"status": 1}, Role.REPLY)]
        for _ in range(3):
            host.send(frame(1, READ))
            assert answers(host) == [(1, REPLY)]
    assert [name for _, name in drive.taken] == ["calibrate", "read_speed", "read_speed", "read_speed"]


def test_endpoints() -> None:
    assert parse_endpoint("virtual:a b") == ("virtual", "a b", {})
    assert parse_endpoint("slcan:/dev/ttyACM0,bitrate=500000") == ("slcan", "/dev/ttyACM0", {"bitrate": 500000})
    assert parse_endpoint("udp_multicast:ff15::1,port=5,x=0.5,y=z") == (
        "udp_multicast", "ff15::1", {"port": 5, "x": 0.5, "y": "z"},
    )  # fmt: skip


@pytest.mark.parametrize("text", ["", "virtual", "virtual:", ":x", "virtual:x,bitrate", "virtual:x,bitrate=fast"])
def test_what_is_no_endpoint(text: str) -> None:
    with pytest.raises(UsageError, match="expected"):
        parse_endpoint(text)


def test_an_interface_that_does_not_open_is_told() -> None:
    with pytest.raises(UsageError, match=r"no CAN interface 'vrtual' \(python-can has .*virtual"):
        LibraryPort("vrtual", "x")
    with pytest.raises(UsageError, match="cannot open slcan:/dev/no-such-port: "):
        LibraryPort("slcan", "/dev/no-such-port", sleep_after_open=0)
