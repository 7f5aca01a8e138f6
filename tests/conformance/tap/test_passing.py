"""What passes through a tap: bytes both ways, speed, adapters that come and go; with real pseudo-terminals, in this process."""

from __future__ import annotations

import contextlib
import os
import random
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import serial

from analyzer.live.endpoint import Endpoint, parse
from analyzer.live.reader_port import Stop, Unopened
from analyzer.live.reader_store import Store
from analyzer.live.spool import Record, RecordKind, SpoolReader, SpoolWriter
from analyzer.values import counted
from conformance.serve.line_speed import line_speed
from conformance.serve.pty import PtyPort
from conformance.tap import passing as module
from conformance.tap.adapter import Adapter, SerialAdapter, TcpAdapter, Wiring, adapter_of
from conformance.tap.passing import Passing
from conformance.tap.settings import LineSettings, of_endpoint, of_terminal, set_terminal
from conformance.tap.storing import REPLY, REQUEST, Storing, Taken
from conformance.tap.terminal import Terminal
from tests.conformance.drives.served import read_from, wait_for


class Far:
    """The far end of the adapter: a pseudo-terminal whose master plays the drive. Its place is a link that can be moved."""

    def __init__(self, folder: Path) -> None:
        self.link = folder / "adapter"
        self.plug_in()

    def plug_in(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.link.symlink_to(os.ttyname(self.slave))

    def unplug(self) -> None:
        self.link.unlink()
        os.close(self.slave)
        os.close(self.master)

    def read(self, count: int, seconds: float = 5.0) -> bytes:
        return read_from(self.master, count, seconds)

    def write(self, data: bytes) -> None:
        os.write(self.master, data)

    def settings(self) -> tuple[int | None, bool, bool]:
        """Speed, odd parity, two stop bits."""
        control = termios.tcgetattr(self.slave)[2]
        return line_speed(self.slave), bool(control & termios.PARODD), bool(control & termios.CSTOPB)


class Tapped:
    """A tap in a thread of this process. `port`: what the program opens; `far`: what the adapter leads to."""

    def __init__(self, folder: Path, adapter: Adapter, endpoint: Endpoint, limit: int = 64 << 20) -> None:
        self.folder = folder
        self.told: list[tuple[str, dict[str, Any]]] = []
        named = of_endpoint(endpoint)
        self._pty = PtyPort()
        set_terminal(self._pty.slave, named)
        self.port = self._pty.path
        stores = {
            direction: Store(SpoolWriter(folder, f"{n}-left-{direction}"), self._tell)
            for n, direction in ((1, REQUEST), (2, REPLY))
        }
        self.storing = Storing(stores, queue_limit=limit)
        self.stop = Stop()
        self.terminal = Terminal(os.dup(self._pty.descriptors()[0]), os.dup(self._pty.slave))
        adapter.open(self.stop, named)
        self.adapter = adapter
        self.passing = Passing(self.terminal, adapter, self.storing, self.stop, named)
        self._thread = threading.Thread(target=self.passing.run)
        self._thread.start()

    def _tell(self, t_ns: int, event: str, about: dict[str, Any]) -> None:
        self.told.append((event, about))

    def close(self) -> None:
        if self._thread.is_alive():
            self.stop.ask("the test is over")
            self._thread.join(10)
            assert not self._thread.is_alive()
            self.adapter.close()
            self.terminal.close()
            self.storing.close("the test is over")
            self._pty.close()

    def records(self, direction: str) -> list[Record]:
        stem = "1-left-request" if direction == REQUEST else "2-left-reply"
        reader = SpoolReader(self.folder, stem)
        try:
            return list(reader.read(1 << 30))
        finally:
            reader.close()

    def stored(self, direction: str) -> bytes:
        return b"".join(r.data for r in self.records(direction) if r.kind == RecordKind.DATA)

    def notes(self) -> list[str]:
        return [about["text"] for event, about in self.told if event == "note"]


@pytest.fixture
def far(tmp_path: Path) -> Iterator[Far]:
    end = Far(tmp_path)
    yield end
    with suppress(OSError):
        end.unplug()


@pytest.fixture
def tapped(tmp_path: Path, far: Far) -> Iterator[Tapped]:
    endpoint = parse(f"left=serial:{far.link},baud=38400")
    tap = Tapped(tmp_path, SerialAdapter(endpoint, Wiring()), endpoint)
    yield tap
    tap.close()


@contextmanager
def program(tap: Tapped) -> Iterator[int]:
    """A program that has the port open and changes nothing."""
    fd = os.open(tap.port, os.O_RDWR | os.O_NOCTTY)
    assert wait_for(lambda: tap.terminal.attended)
    try:
        yield fd
    finally:
        os.close(fd)


def test_every_byte_passes_unchanged_both_ways(tapped: Tapped, far: Far) -> None:
    every = bytes(range(256)) * 4
    with program(tapped) as fd:
        os.write(fd, every)
        assert far.read(len(every)) == every
        far.write(every[::-1])
        assert read_from(fd, len(every)) == every[::-1]
    tapped.close()
    assert tapped.stored(REQUEST) == every
    assert tapped.stored(REPLY) == every[::-1]
    assert not [r for r in tapped.records(REQUEST) if r.kind == RecordKind.EVENT and r.event["event"] != "closed"]


def test_much_passes_both_ways_at_once(tapped: Tapped, far: Far) -> None:
    out, back = random.Random(1).randbytes(300_000), random.Random(2).randbytes(300_000)
    got: dict[str, bytes] = {}

    def pump(name: str, fd: int, data: bytes) -> None:
        """Write all of it, and read as much."""
        os.set_blocking(fd, False)
        received = bytearray()
        at = 0
        deadline = time.monotonic() + 20
        while (at < len(data) or len(received) < 300_000) and time.monotonic() < deadline:
            readable, writable, _ = select.select([fd], [fd] if at < len(data) else [], [], 1.0)
            if writable:
                with suppress(BlockingIOError):
                    at += os.write(fd, data[at : at + 4096])
            if readable:
                received += os.read(fd, 65536)
        got[name] = bytes(received)

    with program(tapped) as fd:
        other = threading.Thread(target=pump, args=("drive", far.master, back))
        other.start()
        pump("program", fd, out)
        other.join(20)
    assert got == {"program": back, "drive": out}
    tapped.close()
    assert tapped.stored(REQUEST) == out
    assert tapped.stored(REPLY) == back


def test_times_of_requests_are_those_of_their_end_on_the_line(tapped: Tapped, far: Far) -> None:
    with program(tapped) as fd:
        before = time.monotonic_ns()
        os.write(fd, bytes(96))
        assert len(far.read(96)) == 96
        after = time.monotonic_ns()
        # 96 bytes at 38400 baud are on the line for 25 ms, although a pseudo-terminal has them at once.
        assert wait_for(lambda: bool(tapped.stored(REQUEST)))
    tapped.close()
    (record,) = [r for r in tapped.records(REQUEST) if r.kind == RecordKind.DATA]
    assert before + 25_000_000 <= record.t_ns <= after + 25_100_000


def test_a_reply_never_stands_before_its_request(tapped: Tapped, far: Far) -> None:
    with program(tapped) as fd:
        for n in range(20):
            os.write(fd, bytes([n]) * 40)
            assert len(far.read(40)) == 40
            # Sooner than the line could have carried the request.
            far.write(bytes([n]) * 4)
            assert len(read_from(fd, 4)) == 4
    tapped.close()
    requests = [r for r in tapped.records(REQUEST) if r.kind == RecordKind.DATA]
    replies = [r for r in tapped.records(REPLY) if r.kind == RecordKind.DATA]
    # What was written at one go may be read in pieces.
    spans = []
    for n in range(20):
        for records, size in ((requests, 40), (replies, 4)):
            own = [r for r in records if r.data[0] == n]
            assert b"".join(r.data for r in own) == bytes([n]) * size
            spans.append((own[0].t_ns, own[-1].t_ns))
    assert all(before[1] <= after[0] for before, after in pairwise(spans))


def test_speed_parity_and_stop_bits_of_the_program_are_followed(tapped: Tapped, far: Far) -> None:
    assert far.settings() == (38400, False, False)
    with serial.Serial(tapped.port, 115200, parity="O", stopbits=2, timeout=2) as port:
        # What is written right after the change goes out at the new speed.
        port.write(b"\x01")
        assert far.read(1) == b"\x01"
        assert far.settings() == (115200, True, True)
        port.baudrate = 25000
        port.parity = "N"
        port.stopbits = 1
        assert wait_for(lambda: far.settings() == (25000, False, False))
    tapped.close()
    speeds = [(about["speed"], about["byte_ns"]) for event, about in tapped.told if event == "speed"]
    assert speeds[0] == (115200, 12 * 10**9 // 115200)
    assert speeds[-1] == (25000, 10 * 10**9 // 25000)


def test_what_was_written_before_a_change_of_speed_goes_out_before_it(
    tapped: Tapped, far: Far, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = [3]

    def unsent(fd: int) -> int:
        waiting[0] = max(0, waiting[0] - 1)
        return waiting[0]

    monkeypatch.setattr(module, "unsent", unsent)
    with program(tapped) as fd:
        attributes = termios.tcgetattr(fd)
        attributes[4] = attributes[5] = termios.B9600
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        assert wait_for(lambda: far.settings()[0] == 9600)
    assert waiting == [0]


def test_even_parity_is_the_endpoints_because_a_pseudo_terminal_does_not_tell_it() -> None:
    even = of_endpoint(parse("serial:/dev/x,parity=even"))
    odd = of_endpoint(parse("serial:/dev/x,parity=odd,stop=2"))
    master, slave = os.openpty()
    try:
        set_terminal(slave, even)
        assert of_terminal(slave, even) == LineSettings(38400, "E", 1)
        set_terminal(slave, odd)
        assert of_terminal(slave, odd) == LineSettings(38400, "O", 2)
        # The mark of odd parity is all there is of it: taken away, it means none.
        set_terminal(slave, LineSettings(9600, "N", 1))
        assert of_terminal(slave, odd) == LineSettings(9600, "N", 1)
    finally:
        os.close(slave)
        os.close(master)


def test_programs_come_and_go_and_hear_nothing_of_what_was_said_before(tapped: Tapped, far: Far) -> None:
    far.write(b"before anybody came")
    assert wait_for(lambda: len(tapped.stored(REPLY)) == 19)
    with program(tapped) as fd:
        far.write(b"to the first")
        assert read_from(fd, 12) == b"to the first"
        far.write(b"never read")
        assert wait_for(lambda: len(tapped.stored(REPLY)) == 41)
    assert wait_for(lambda: not tapped.terminal.attended)
    far.write(b"to nobody")
    assert wait_for(lambda: len(tapped.stored(REPLY)) == 50)
    with program(tapped) as fd:
        far.write(b"to the second")
        assert read_from(fd, 13) == b"to the second"
    tapped.close()
    assert tapped.stored(REPLY) == b"before anybody cameto the firstnever readto nobodyto the second"


def test_what_a_program_writes_just_before_it_closes_is_sent(tapped: Tapped, far: Far) -> None:
    with program(tapped) as fd:
        os.write(fd, b"goodbye")
    assert far.read(7) == b"goodbye"


def test_a_program_may_lock_its_port_and_the_next_one_gets_it(tapped: Tapped) -> None:
    for _ in range(3):
        with serial.Serial(tapped.port, 38400, exclusive=True):
            assert wait_for(lambda: tapped.terminal.attended)
        assert wait_for(lambda: not tapped.terminal.attended)


def test_a_program_that_does_not_read_loses_what_is_too_much_and_the_recording_nothing(
    tapped: Tapped, far: Far, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PROGRAM_LIMIT", 20_000)
    block = bytes(range(250)) * 4
    with program(tapped):
        for _ in range(100):
            before = len(tapped.stored(REPLY))
            far.write(block)
            assert wait_for(lambda before=before: len(tapped.stored(REPLY)) > before)  # type: ignore[misc]
        assert wait_for(lambda: any("did not reach it" in note for note in tapped.notes()))
    tapped.close()
    assert tapped.stored(REPLY) == block * 100


def test_an_adapter_that_does_not_take_bytes_makes_the_program_wait(tapped: Tapped, far: Far) -> None:
    data = random.Random(3).randbytes(60_000)
    with program(tapped) as fd:
        os.set_blocking(fd, False)
        at = 0
        deadline = time.monotonic() + 5
        # The far end does not read: the program blocks long before its end.
        while at < len(data) and select.select([], [fd], [], 0.3)[1] and time.monotonic() < deadline:
            with suppress(BlockingIOError):
                at += os.write(fd, data[at : at + 1000])
        assert 0 < at < len(data)
        received = b""
        while len(received) < len(data):
            received += far.read(4096, 0.05)
            if at < len(data):
                with suppress(BlockingIOError):
                    at += os.write(fd, data[at : at + 1000])
            assert time.monotonic() < deadline + 10
    assert received == data
    tapped.close()
    assert tapped.stored(REQUEST) == data


def test_what_a_blocked_adapter_did_not_take_is_told_at_the_end(tapped: Tapped) -> None:
    at, waits = 0, 0
    with program(tapped) as fd:
        os.set_blocking(fd, False)
        while waits < 3:
            try:
                at += os.write(fd, b"x" * 1000)
                waits = 0
            except BlockingIOError:
                waits += not select.select([], [fd], [], 0.1)[1]
    tapped.close()
    sent = len(tapped.stored(REQUEST))
    assert sent < at
    said = f"{counted(at - sent, 'byte')} that the program wrote were not sent: the adapter took no more"
    assert any(said in note for note in tapped.notes()), tapped.notes()


def test_what_a_program_writes_while_the_tap_ends_is_told_as_that(tapped: Tapped, monkeypatch: pytest.MonkeyPatch) -> None:
    left = tapped.passing._left_by_program
    with program(tapped) as fd:

        def late() -> int:
            os.write(fd, b"late")
            return left()

        monkeypatch.setattr(tapped.passing, "_left_by_program", late)
        tapped.close()
    assert "4 bytes that the program wrote were not sent: the tap was ending" in tapped.notes()


def test_an_adapter_that_is_unplugged_comes_back_under_the_programs_feet(tapped: Tapped, far: Far) -> None:
    with program(tapped) as fd:
        os.write(fd, b"one")
        assert far.read(3) == b"one"
        far.unplug()
        assert wait_for(lambda: any(event == "lost" for event, _ in tapped.told))
        os.write(fd, b"into the void")
        assert wait_for(lambda: any("13 bytes that the program wrote were not sent" in note for note in tapped.notes()))
        attributes = termios.tcgetattr(fd)
        attributes[4] = attributes[5] = termios.B9600
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        far.plug_in()
        assert wait_for(lambda: any(event == "back" for event, _ in tapped.told))
        os.write(fd, b"two")
        assert far.read(3) == b"two"
        # What the program set meanwhile holds.
        assert wait_for(lambda: far.settings()[0] == 9600)
        far.write(b"three")
        assert read_from(fd, 5) == b"three"
    tapped.close()
    assert tapped.stored(REQUEST) == b"onetwo"
    assert [e for e, _ in tapped.told if e in ("lost", "back")] == ["lost", "back"]
    assert any("is not there" in note for note in tapped.notes())


def test_a_disk_that_stands_still_delays_no_byte(tmp_path: Path, far: Far, monkeypatch: pytest.MonkeyPatch) -> None:
    hold = threading.Event()
    real = Store.flush

    def flush(store: Store) -> None:
        hold.wait(20)
        real(store)

    monkeypatch.setattr(Store, "flush", flush)
    endpoint = parse(f"left=serial:{far.link},baud=38400")
    tap = Tapped(tmp_path, SerialAdapter(endpoint, Wiring()), endpoint, limit=1000)
    try:
        with program(tap) as fd:
            for n in range(30):
                os.write(fd, bytes([n]) * 50)
                assert far.read(50) == bytes([n]) * 50
                far.write(bytes([n]) * 50)
                assert read_from(fd, 50) == bytes([n]) * 50
            hold.set()
            assert wait_for(lambda: any(event == "dropped" for event, _ in tap.told))
    finally:
        hold.set()
        tap.close()
    dropped = sum(about["bytes"] for event, about in tap.told if event == "dropped")
    assert dropped > 0
    assert len(tap.stored(REQUEST)) + len(tap.stored(REPLY)) + dropped == 3000
    last = [r for r in tap.records(REPLY) if r.kind == RecordKind.DATA][-1]
    assert last.before + last.units <= 1500


def test_a_serial_server(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = parse(f"left=tcp:127.0.0.1:{server.getsockname()[1]}")
        tap = Tapped(tmp_path, TcpAdapter(endpoint), endpoint)
        try:
            connection, _ = server.accept()
            with program(tap) as fd:
                os.write(fd, b"ask")
                assert read_from(connection.fileno(), 3) == b"ask"
                connection.sendall(b"answer")
                assert read_from(fd, 6) == b"answer"
                connection.close()
                assert wait_for(lambda: any(event == "lost" for event, _ in tap.told))
                connection, _ = server.accept()
                assert wait_for(lambda: any(event == "back" for event, _ in tap.told))
                os.write(fd, b"again")
                assert read_from(connection.fileno(), 5) == b"again"
                connection.close()
        finally:
            tap.close()
    assert tap.stored(REQUEST) == b"askagain"


@pytest.mark.parametrize(
    ("wiring", "text"), [(Wiring(rts=True), "no RTS and DTR to set"), (Wiring(rs485=True), "cannot raise RTS while it sends")]
)
def test_lines_that_an_adapter_does_not_have(wiring: Wiring, text: str, far: Far) -> None:
    endpoint = parse(f"serial:{far.link}")
    with pytest.raises(Unopened, match=text):
        SerialAdapter(endpoint, wiring).open(Stop(), of_endpoint(endpoint))


def test_adapters_that_cannot_be_opened(tmp_path: Path, far: Far) -> None:
    cases: list[tuple[str, str]] = [
        (f"serial:{tmp_path}/none", "is not there"),
        (f"serial:{__file__}", "is not a serial port"),
        ("serial:,serial=NOBODY", "no adapter with serial number NOBODY"),
        ("tcp:127.0.0.1:1", "cannot connect"),
    ]
    for text, why in cases:
        endpoint = parse(text)
        with pytest.raises(Unopened, match=why):
            adapter_of(endpoint, Wiring()).open(Stop(), of_endpoint(endpoint))
    endpoint = parse(f"serial:{far.link}")
    first = adapter_of(endpoint, Wiring())
    first.open(Stop(), of_endpoint(endpoint))
    with pytest.raises(Unopened, match="locked by another program"):
        adapter_of(endpoint, Wiring()).open(Stop(), of_endpoint(endpoint))
    first.close()
    first.close()


def test_a_tap_goes_on_without_its_supervisor_while_a_program_is_there(tmp_path: Path, far: Far) -> None:
    endpoint = parse(f"left=serial:{far.link},baud=38400")
    tap = Tapped(tmp_path, SerialAdapter(endpoint, Wiring()), endpoint)
    keep: Callable[[], bool] = lambda: True  # noqa: E731
    tap.passing._keep_on = keep
    try:
        with program(tap) as fd:
            tap.stop.ask("the supervisor has gone")
            os.write(fd, b"on and on")
            assert far.read(9) == b"on and on"
        assert wait_for(lambda: not tap._thread.is_alive())
    finally:
        tap._thread.join(5)
        tap.adapter.close()
        tap.terminal.close()
        tap.storing.close("over")
    assert tap.stored(REQUEST) == b"on and on"


def test_what_a_tap_had_taken_outlives_it(tmp_path: Path) -> None:
    place = tmp_path / "2-left.taken"
    first = Taken(place, {REQUEST: 0, REPLY: 0})
    assert first.before is None
    first.add(REQUEST, 7)
    first.add(REPLY, 30)
    first.add(REQUEST, 3)
    # Of these it stored 8 and 30, and then it died.
    second = Taken(place, {REQUEST: 8, REPLY: 30})
    assert second.before == second.counts == {REQUEST: 10, REPLY: 30}
    place.write_bytes(b"damaged")
    assert Taken(place, {REQUEST: 8, REPLY: 30}).counts == {REQUEST: 8, REPLY: 30}


def test_a_program_that_was_there_before_the_tap_looked_is_served():
    with contextlib.closing(PtyPort()) as port:
        program = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        terminal = Terminal(*(os.dup(fd) for fd in (port.descriptors()[0], port.slave)), others=lambda: True)
        assert terminal.attended
        os.close(program)
        assert terminal.look()
        assert not terminal.attended
        came = []
        late = Terminal(
            *(os.dup(fd) for fd in (port.descriptors()[0], port.slave)),
            others=lambda: bool(came.append(os.open(port.path, os.O_RDWR | os.O_NOCTTY)) or came),
        )
        assert late.attended
        os.close(came[0])
        assert late.look()
        assert not late.attended
        terminal.close()
        late.close()
