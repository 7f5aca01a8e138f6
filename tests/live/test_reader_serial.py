"""Reading serial ports: pseudo-terminals with real processes, and what only a real adapter has by its numbers."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import socket
import termios
import threading
import tty
from contextlib import contextmanager, suppress

import pytest

from analyzer.live import reader_serial
from analyzer.live.endpoint import parse
from analyzer.live.reader_hand import Hand
from analyzer.live.reader_port import Lost, Stop, Unopened, find_adapter
from analyzer.live.reader_serial import TCGETS2, TERMIOS2, SerialPort, holders, set_raw
from analyzer.live.reader_store import Store
from analyzer.live.spool import RecordKind, SpoolReader, SpoolWriter
from tests.conformance.drives.served import wait_for
from tests.live.readers import ReaderProcess, fill
from tests.live.recorded import pty_pair

PLAIN = pytest.mark.parametrize("plain", [(), ("--plain",)], ids=["linux", "pyserial"])


@pytest.fixture
def stop():
    made = Stop()
    yield made
    made.close()


def attributes(path):
    fd = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        return TERMIOS2.unpack(fcntl.ioctl(fd, TCGETS2, bytes(TERMIOS2.size)))
    finally:
        os.close(fd)


# --- opening --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [9600, 25000, 38400, 256000, 1_234_567, 4_000_000])
def test_any_rate_is_set_raw_with_nothing_that_touches_a_byte(speed, stop):
    with pty_pair() as (_, path):
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        # A terminal echoes until a program sets it up.
        tty.setcbreak(fd)
        mode = termios.tcgetattr(fd)
        mode[3] |= termios.ECHO | termios.ICANON
        termios.tcsetattr(fd, termios.TCSANOW, mode)
        port = SerialPort(parse(f"serial:{path},baud={speed}"))
        opened = port.open(stop)
        iflag, oflag, cflag, lflag, _, characters, ispeed, ospeed = attributes(path)
        assert (iflag, oflag, lflag) == (0, 0, 0)
        assert (ispeed, ospeed) == (speed, speed)
        assert cflag & (termios.CSIZE | termios.CREAD | termios.CLOCAL) == termios.CS8 | termios.CREAD | termios.CLOCAL
        assert not cflag & (termios.CRTSCTS | termios.PARENB | termios.CSTOPB)
        assert (characters[termios.VMIN], characters[termios.VTIME]) == (1, 0)
        assert not any("runs at" in note for note in opened.notes)
        port.close()
        os.close(fd)


@pytest.mark.parametrize(
    ("options", "flags"),
    [
        ("parity=even", termios.PARENB),
        ("parity=odd", termios.PARENB | termios.PARODD),
        ("parity=none", 0),
        ("stop=2", termios.CSTOPB),
    ],
)
def test_parity_and_stop_bits_are_asked_of_the_driver(options, flags, monkeypatch):
    asked = []
    ioctl = fcntl.ioctl
    monkeypatch.setattr(
        reader_serial.fcntl, "ioctl", lambda fd, number, data: asked.append((number, data)) or ioctl(fd, number, data)
    )
    with pty_pair() as (_, path):
        endpoint = parse(f"serial:{path},baud=9600,{options}")
        fd = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        set_raw(fd, 9600, endpoint.parity, endpoint.stop_bits)
        os.close(fd)
    control = next(TERMIOS2.unpack(data)[2] for number, data in asked if number == reader_serial.TCSETS2)
    assert control & (termios.PARENB | termios.PARODD | termios.CSTOPB) == flags


def test_rts_and_dtr_are_lowered_after_the_port_is_raw_and_it_is_told_how_long_they_were_up(stop, monkeypatch):
    asked = []
    ioctl = fcntl.ioctl

    def answered(fd, number, data):
        asked.append((number, data))
        return data if number == termios.TIOCMBIC else ioctl(fd, number, data)

    monkeypatch.setattr(reader_serial.fcntl, "ioctl", answered)
    with pty_pair() as (_, path):
        port = SerialPort(parse(f"serial:{path},baud=9600"))
        opened = port.open(stop)
        port.close()
    numbers = [number for number, _ in asked]
    assert numbers.index(reader_serial.TCSETS2) < numbers.index(termios.TIOCMBIC)
    lowered = int.from_bytes(dict(asked)[termios.TIOCMBIC], "little")
    assert lowered == termios.TIOCM_RTS | termios.TIOCM_DTR
    assert any("RTS and DTR" in note and "within" in note for note in opened.notes)


def test_a_port_at_another_rate_than_asked_is_told(stop, monkeypatch):
    monkeypatch.setattr(reader_serial, "set_raw", lambda fd, speed, parity, stop_bits: 250_000)
    with pty_pair() as (_, path):
        port = SerialPort(parse(f"serial:{path},baud=256000"))
        assert "the port runs at 250000 baud instead of 256000" in port.open(stop).notes
        port.close()


def test_why_a_port_cannot_be_opened(tmp_path, stop, monkeypatch):
    def refused(place):
        with pytest.raises(Unopened) as why:
            SerialPort(parse(f"serial:{place},baud=9600")).open(stop)
        return str(why.value)

    assert "is not there" in refused("/dev/none")
    (tmp_path / "file").write_bytes(b"")
    assert "is not a serial port" in refused(tmp_path / "file")
    assert "is not a serial port" in refused(tmp_path)
    monkeypatch.setattr(os, "open", lambda path, flags: (_ for _ in ()).throw(PermissionError(errno.EACCES, "denied")))
    assert "dialout" in refused("/dev/ttyUSB0")
    monkeypatch.setattr(os, "open", lambda path, flags: (_ for _ in ()).throw(OSError(errno.EBUSY, "busy")))
    assert "busy" in refused("/dev/ttyUSB0")


def test_a_port_that_another_program_has_locked_is_refused_and_ours_is_locked(stop):
    with pty_pair() as (_, path):
        other = os.open(path, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        port = SerialPort(parse(f"serial:{path},baud=9600"))
        with pytest.raises(Unopened, match="locked by another program"):
            port.open(stop)
        fcntl.flock(other, fcntl.LOCK_UN)
        port.open(stop)
        with pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        port.close()
        os.close(other)


def test_who_else_has_a_port_open():
    with pty_pair() as (_, path):
        fd = os.open(path, os.O_RDONLY | os.O_NOCTTY)
        child = os.fork()
        if child == 0:
            signal.pause()
            os._exit(0)
        try:
            assert any(f"(process {child})" in text for text in holders(fd))
            assert not any(f"(process {os.getpid()})" in text for text in holders(fd))
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            os.close(fd)


def test_an_adapter_is_found_by_its_serial_number(monkeypatch):
    from serial.tools import list_ports
    from serial.tools.list_ports_common import ListPortInfo

    def info(device, number):
        made = ListPortInfo(device, skip_link_detection=True)
        made.serial_number = number
        return made

    there = [info("/dev/ttyUSB0", "A1"), info("/dev/ttyUSB3", "B2")]
    monkeypatch.setattr(list_ports, "comports", lambda: there)
    assert find_adapter("B2") == "/dev/ttyUSB3"
    with pytest.raises(Unopened, match="A1 at /dev/ttyUSB0, B2 at /dev/ttyUSB3"):
        find_adapter("C3")
    there.append(info("/dev/ttyUSB5", "A1"))
    with pytest.raises(Unopened, match="2 ports have the serial number A1: /dev/ttyUSB0, /dev/ttyUSB5; name one"):
        find_adapter("A1")


# --- counters -------------------------------------------------------------------------------------------------------------


def test_the_kernels_counters_are_told_as_they_rise(tmp_path, stop, monkeypatch):
    counts = iter([(0, 0, 0, 0, 0), (0, 0, 0, 0, 0), (2, 5, 0, 0, 0), (2, 5, 0, 1, 9)])
    names = reader_serial.COUNTED
    monkeypatch.setattr(reader_serial, "counters", lambda fd: dict(zip(names, next(counts), strict=True)))
    with pty_pair() as (_, path):
        port = SerialPort(parse(f"serial:{path},baud=9600"))
        assert not any("counts no overruns" in note for note in port.open(stop).notes)
        store = Store(SpoolWriter(tmp_path, "1-a"), lambda *_: None)
        for now_ns in (1, 2, 3):
            port._count(store, now_ns * 10**9)
        port.close()
    events = [r.event for r in SpoolReader(tmp_path, "1-a").read()]
    assert [{k: v for k, v in e.items() if k != "from_ns"} for e in events] == [
        {"event": "overrun", "frame": 2, "overrun": 5},
        {"event": "overrun", "brk": 1, "buf_overrun": 9},
    ]
    assert events[1]["from_ns"] == 2 * 10**9


def test_what_the_kernel_lost_while_there_was_no_reader_is_told_by_the_next(tmp_path, stop, monkeypatch):
    names, kernel = reader_serial.COUNTED, [7, 1, 0, 0, 3]
    monkeypatch.setattr(reader_serial, "counters", lambda fd: dict(zip(names, kernel, strict=True)))
    stop.ask("it is to look once")
    memory = Hand.make()
    store = Store(SpoolWriter(tmp_path, "1-a"), lambda *_: None, hand=Hand(memory), last_ns=5)
    with pty_pair() as (_, path):
        first, second = SerialPort(parse(f"serial:{path},baud=9600")), SerialPort(parse(f"serial:{path},baud=9600"))
        first.open(stop)
        first.listen(store, stop)
        kernel[1] += 4
        first._count(store, 6)
        # Here the first one dies.
        kernel[4] += 2
        second.adopt(os.dup(first.descriptor()))
        first.close()
        second.listen(store, stop)
        second._count(store, 7)
        second.close()
    os.close(memory)
    store.flush()
    told = [r.event for r in SpoolReader(tmp_path, "1-a").read() if r.kind == RecordKind.EVENT]
    assert [{k: v for k, v in e.items() if k != "from_ns"} for e in told] == [
        {"event": "overrun", "overrun": 4},
        {"event": "overrun", "buf_overrun": 2},
    ]


def test_where_the_driver_counts_nothing_it_is_said_once(stop):
    with pty_pair() as (_, path):
        port = SerialPort(parse(f"serial:{path},baud=9600"))
        assert sum("counts no overruns" in note for note in port.open(stop).notes) == 1
        port.close()


# --- listening ------------------------------------------------------------------------------------------------------------


@PLAIN
def test_what_comes_is_stored_with_possible_times_and_pauses(tmp_path, plain):
    with pty_pair() as (master, path), ReaderProcess(tmp_path, f"serial:{path},baud=115200", *plain) as reader:
        assert reader.opened["precision"]
        os.write(master, b"first")
        assert wait_for(lambda: [r.kind for r in reader.records()][-1:] == [RecordKind.IDLE])
        os.write(master, b"second")
        assert wait_for(lambda: reader.data() == b"firstsecond")
        assert reader.end() == 0
        records = reader.records()
        assert [r.kind for r in records if r.kind != RecordKind.EVENT][:2] == [RecordKind.DATA, RecordKind.IDLE]
        times = [r.t_ns for r in records]
        assert times == sorted(times)
        chunks = sum(r.kind == RecordKind.DATA for r in records)
        assert reader.events("closed") == [{"event": "closed", "reason": "asked to end", "records": chunks, "bytes": 11}]


@PLAIN
@pytest.mark.parametrize("how", [signal.SIGTERM, None], ids=["asked", "supervisor dead"])
def test_what_had_come_when_the_end_is_wished_is_stored(tmp_path, plain, how):
    with pty_pair() as (master, path), ReaderProcess(tmp_path, f"serial:{path},baud=4000000", *plain) as reader:
        # While it stands still it reads nothing: all of this waits in the kernel.
        reader.process.send_signal(signal.SIGSTOP)
        os.write(master, bytes(range(256)) * 10)
        if how is None:
            reader.leash.close()
        else:
            reader.process.send_signal(how)
        reader.process.send_signal(signal.SIGCONT)
        assert reader.process.wait(15) == 0
        assert reader.data() == bytes(range(256)) * 10
        assert len(reader.events("closed")) == 1


def test_a_lot_arrives_whole_and_in_order(tmp_path):
    data = os.urandom(1 << 20)
    with pty_pair() as (master, path), ReaderProcess(tmp_path, f"serial:{path},baud=4000000") as reader:
        fill(master, data)
        assert wait_for(lambda: reader.records()[-1].kind == RecordKind.IDLE, 10)
        assert reader.end() == 0
        assert reader.data() == data
        expected = 0
        for record in reader.records():
            assert record.before == expected
            expected += record.units


@contextmanager
def terminal(link):
    """A pseudo-terminal whose path is a link that stays the same, as a device of udev does."""
    master, slave = os.openpty()
    tty.setraw(slave)
    link.unlink(missing_ok=True)
    link.symlink_to(os.ttyname(slave))
    try:
        yield master
    finally:
        os.close(slave)
        os.close(master)
        link.unlink(missing_ok=True)


@PLAIN
def test_a_port_that_is_unplugged_and_back_leaves_a_gap_with_its_times(tmp_path, plain):
    link = tmp_path / "ttyUSB9"
    with terminal(link) as master:
        reader = ReaderProcess(tmp_path, f"serial:{link},baud=115200", *plain)
        os.write(master, b"before")
        assert wait_for(lambda: reader.data() == b"before")
    with reader:
        lost = reader.wait_event("lost")
        assert lost["reason"]
        note = reader.wait_event("note")
        assert "ttyUSB9" in note["text"]
        with terminal(link) as master:
            back = reader.wait_event("back")
            os.write(master, b"after")
            assert wait_for(lambda: reader.data() == b"beforeafter")
            assert reader.end() == 0
    assert back["from_ns"] == lost["t_ns"]
    assert back["gap_ns"] == back["t_ns"] - lost["t_ns"] > 0
    kinds = [r.event["event"] if r.kind == RecordKind.EVENT else r.kind for r in reader.records()]
    assert kinds.index("lost") < kinds.index("back") < kinds.index("closed")
    assert len(reader.events("note")) == 1, "the same reason is told once"


def test_a_port_that_cannot_be_opened_at_the_start_is_told_and_nothing_more(tmp_path):
    with ReaderProcess(tmp_path, "serial:/dev/none,baud=9600", wait="failed") as reader:
        assert reader.process.wait(10) == 2
        assert "is not there" in reader.opened["reason"]
        assert reader.records() == []


def test_a_reader_that_is_killed_has_handed_its_port_over_and_a_successor_loses_nothing(tmp_path):
    with pty_pair() as (master, path):
        with ReaderProcess(tmp_path, f"serial:{path},baud=115200") as reader:
            kept = reader.handed_over()
            os.write(master, b"before")
            assert wait_for(lambda: reader.data() == b"before")
            reader.end(signal.SIGKILL)
        os.write(master, b"meanwhile")
        with ReaderProcess(
            tmp_path, f"serial:{path},baud=115200", "--adopt", str(kept), pass_fds=(kept,), wait="note"
        ) as reader:
            assert reader.opened["kept"]
            os.write(master, b"after")
            assert wait_for(lambda: reader.data() == b"beforemeanwhileafter")
            assert reader.end() == 0
            expected = 0
            for record in reader.records():
                assert record.before == expected
                expected += record.units
        os.close(kept)


def test_a_reader_whose_inheritance_is_worth_nothing_opens_the_port_itself(tmp_path):
    with pty_pair() as (master, path):
        with ReaderProcess(tmp_path, f"serial:{path},baud=115200") as reader:
            reader.end(signal.SIGKILL)
        read, write = os.pipe()
        with ReaderProcess(
            tmp_path, f"serial:{path},baud=115200", "--adopt", str(read), pass_fds=(read,), wait="back"
        ) as reader:
            os.write(master, b"x")
            assert wait_for(lambda: reader.data() == b"x")
        os.close(read)
        os.close(write)


# --- the wish to end ------------------------------------------------------------------------------------------------------


def test_a_wish_wakes_whoever_waits(stop):
    thread = threading.Timer(0.01, stop.ask, ["over"])
    thread.start()
    assert stop.wait(30)
    assert stop.asked == "over"
    assert stop.wait(30)


def test_the_end_of_the_leash_is_a_wish(stop):
    ours, theirs = socket.socketpair()
    stop.on_leash(theirs.fileno())
    assert not stop.wait(0)
    ours.close()
    assert stop.wait(30)
    assert "supervisor" in stop.asked
    theirs.close()


def test_a_stream_that_ends_is_lost_after_all_of_it_is_stored(tmp_path, stop):
    from analyzer.live.reader_stream import listen_to_stream

    read, write = os.pipe()
    os.set_blocking(read, False)
    os.write(write, b"last words")
    os.close(write)
    store = Store(SpoolWriter(tmp_path, "1-a"), lambda *_: None)
    with pytest.raises(Lost, match="it ended"):
        listen_to_stream(read, store, stop, byte_ns=0, ended="it ended")
    assert [r.data for r in SpoolReader(tmp_path, "1-a").read()] == [b"last words"]
    with suppress(OSError):
        os.close(read)
