"""Reading CAN buses: sockets, python-can's interfaces, and which of them can be told to listen only."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import signal
import socket
import struct
import threading
import time
from queue import SimpleQueue

import can
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.errors import UsageError
from analyzer.live import reader_can_library, reader_can_socket, reader_port
from analyzer.live.adapters import ask_ip, links_of
from analyzer.live.can_listen_only import LISTEN_ONLY, notes_of_link, options_for
from analyzer.live.endpoint import parse
from analyzer.live.reader import make_port
from analyzer.live.reader_can_library import CanLibraryPort
from analyzer.live.reader_can_slcan import SlcanPort, dissect_line
from analyzer.live.reader_can_socket import CanSocketPort, dissect_kernel, dissect_multicast, trouble
from analyzer.live.reader_hand import Hand
from analyzer.live.reader_port import Lost, Stop, Unopened
from analyzer.live.reader_store import Store
from analyzer.live.spool import CanFlag, RecordKind, SpoolReader, SpoolWriter
from tests.conformance.drives.served import read_from, wait_for
from tests.live.readers import ReaderProcess, fill
from tests.live.recorded import pty_pair

GROUP = "239.74.163.81"
#: A datagram of maps in maps: deeper than a decoder goes.
NESTED = b"\x81\xa1a" * 1300


def stored(folder):
    return list(SpoolReader(folder, "1-a").read(1 << 30))


@pytest.fixture
def store(tmp_path):
    return Store(SpoolWriter(tmp_path, "1-a"), lambda *_: None, unit="frames")


@pytest.fixture
def stop():
    made = Stop()
    yield made
    made.close()


# --- what is on a socket --------------------------------------------------------------------------------------------------


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.booleans(), st.booleans(), st.booleans(), st.booleans())
def test_a_datagram_is_understood_as_python_can_understands_it(can_id, data, extended, remote, error, fd):
    from can.interfaces.udp_multicast.utils import pack_message, unpack_message

    message = can.Message(
        arbitration_id=can_id if extended else can_id & 0x7FF, data=None if remote else data, is_extended_id=extended,
        is_remote_frame=remote and not fd, is_error_frame=error, is_fd=fd,
    )  # fmt: skip
    packed = pack_message(message)
    found_id, flags, payload = dissect_multicast(packed)
    expected = unpack_message(packed)
    assert (found_id, payload) == (expected.arbitration_id, bytes(expected.data or b""))
    assert bool(flags & CanFlag.EXTENDED) == expected.is_extended_id
    assert bool(flags & CanFlag.REMOTE) == expected.is_remote_frame
    assert bool(flags & CanFlag.ERROR) == expected.is_error_frame
    assert bool(flags & CanFlag.FD) == expected.is_fd


@given(st.binary(max_size=80))
def test_any_datagram_is_a_frame_or_a_value_error(data):
    for dissect in (dissect_multicast, dissect_kernel):
        try:
            can_id, flags, payload = dissect(data)
        except (ValueError, msgspec.MsgspecError):
            continue
        assert 0 <= can_id < 1 << 32
        assert 0 <= flags < 32
        assert len(payload) <= 64 or dissect is dissect_multicast


@pytest.mark.parametrize(
    ("word", "data", "expected"),
    [
        (0x123, b"\1\2", (0x123, 0, b"\1\2")),
        (0x80000000 | 0x12345678, b"\1" * 8, (0x12345678, CanFlag.EXTENDED, b"\1" * 8)),
        (0x40000000 | 0x7FF, b"", (0x7FF, CanFlag.REMOTE, b"")),
        (0x20000000 | 0x044, b"\0\x01" + b"\0" * 6, (0x044, CanFlag.ERROR, b"\0\x01" + b"\0" * 6)),
    ],
)
def test_a_frame_of_the_kernel(word, data, expected):
    from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame

    frame = struct.pack("=IB3x8s", word, len(data), data)
    assert dissect_kernel(frame) == expected
    theirs, _, _, payload = dissect_can_frame(frame)
    assert (theirs, bytes(payload)) == (word, data)
    fd = build_can_frame(can.Message(arbitration_id=0x321, data=b"x" * 12, is_fd=True, is_extended_id=False))
    assert dissect_kernel(fd) == (0x321, CanFlag.FD, b"x" * 12)


def test_what_an_error_frame_says_about_the_bus():
    assert trouble(0x040, b"\0" * 8) == "bus off"
    assert trouble(0x004, b"\0\x01" + b"\0" * 6) == "the controller's buffer overflowed: frames were lost"
    assert trouble(0x144, b"\0\x10" + b"\0" * 6) == "bus off, the controller was restarted, error passive (receiving)"
    assert trouble(0x008, b"\0" * 8) == ""


class Pair:
    """A port of SocketCAN whose kernel is this test: frames come from the other end of a pair of sockets."""

    def __init__(self, monkeypatch):
        self.ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.port = CanSocketPort(parse("can:socketcan:can9"))
        monkeypatch.setattr(self.port, "_open_kernel", lambda: theirs)
        monkeypatch.setattr(reader_can_socket, "kernel_notes", lambda channel, speed: ["noted"])

    def put(self, word, data):
        self.ours.send(struct.pack("=IB3x8s", word, len(data), data))


def test_frames_of_the_kernel_are_stored_with_trouble_as_events(tmp_path, store, stop, monkeypatch):
    pair = Pair(monkeypatch)
    assert "noted" in pair.port.open(stop).notes
    pair.put(0x123, b"\1\2")
    pair.put(0x20000040, b"\0" * 8)
    pair.put(0x123, b"\3")
    stop.ask("over")
    pair.port.listen(store, stop)
    pair.port.close()
    kinds = [r.event["reason"] if r.kind == RecordKind.EVENT else r.can for r in stored(tmp_path)]
    assert kinds == [(0x123, 0, b"\1\2"), (0x40, CanFlag.ERROR, b"\0" * 8), "bus off", (0x123, 0, b"\3")]
    pair.ours.close()


def test_an_interface_that_goes_down_is_lost(store, stop, monkeypatch):
    pair = Pair(monkeypatch)
    pair.port.open(stop)

    class Down:
        def recvmsg(self, *sizes):
            raise OSError(100, "Network is down")

    poll = pair.port._socket
    pair.ours.send(b"x")
    monkeypatch.setattr(pair.port, "_take", lambda store: CanSocketPort._take(type("P", (), {
        "_socket": Down(), "_dissect": None,
    })(), store))  # fmt: skip
    with pytest.raises(Lost, match="Network is down"):
        pair.port.listen(store, stop)
    poll.close()
    pair.ours.close()


def test_an_interface_that_is_down_is_not_opened(tmp_path, stop, monkeypatch):
    monkeypatch.setattr(reader_can_socket, "Path", lambda text: tmp_path / "flags")
    (tmp_path / "flags").write_text("0x40080\n")
    with pytest.raises(Unopened, match="is down"):
        CanSocketPort(parse("can:socketcan:can0")).open(stop)


def test_how_long_ago_the_kernel_stamped_a_frame_counts_and_not_when(tmp_path, store, monkeypatch):
    port = CanSocketPort(parse("can:socketcan:can0"))
    now_ns = 5_000_000_000
    wall = {"now": 1_000_000_000_000}
    monkeypatch.setattr(reader_can_socket.time, "monotonic_ns", lambda: now_ns)
    monkeypatch.setattr(reader_can_socket.time, "time_ns", lambda: wall["now"])
    frame = struct.pack("=IB3x8s", 1, 1, b"x")

    def stamp(ns):
        seconds, rest = divmod(ns, 1_000_000_000)
        return [(socket.SOL_SOCKET, 35, struct.pack("@qq", seconds, rest))]

    ages = [3_000_000, 1_000_000, -5_000_000, 3600 * 10**9]
    queue = [(frame, stamp(wall["now"] - age), 0, None) for age in ages]

    class Kernel:
        def recvmsg(self, size, ancillary):
            if not queue:
                raise BlockingIOError
            return queue.pop(0)

    port._socket = Kernel()
    assert port._take(store) == (4, 0)
    store.flush()
    # A stamp from the future or of another day is none.
    assert [now_ns - r.t_ns for r in stored(tmp_path)] == [3_000_000, 1_000_000, 0, 0]


# --- udp_multicast, with real processes -----------------------------------------------------------------------------------


@contextlib.contextmanager
def multicast(port, group=GROUP):
    pytest.importorskip("msgpack")
    with can.Bus(interface="udp_multicast", channel=group, port=port, fd=False) as bus:
        yield bus


def message(number):
    return can.Message(arbitration_id=number % 0x7FF + 1, data=number.to_bytes(4, "big"), is_extended_id=False)


@pytest.mark.parametrize("plain", [(), ("--plain",)], ids=["socket", "python-can"])
def test_what_is_on_the_bus_is_stored(tmp_path, plain):
    with multicast(43201) as bus, ReaderProcess(tmp_path, f"can:udp_multicast:{GROUP},port=43201", *plain) as reader:
        # As many at once as a socket's buffer holds, however late the reader gets its turn.
        for first in range(0, 300, 60):
            for number in range(first, first + 60):
                bus.send(message(number))
            assert wait_for(lambda so_far=first + 60: len(reader.frames()) == so_far, 20)
        assert wait_for(lambda: reader.records()[-1].kind == RecordKind.IDLE)
        assert reader.end() == 0
        assert reader.frames() == [(m.arbitration_id, 0, bytes(m.data)) for m in map(message, range(300))]
        assert [r.before for r in reader.records() if r.kind == RecordKind.CAN] == list(range(300))
        times = [r.t_ns for r in reader.records()]
        assert times == sorted(times)
        assert reader.events("closed")[0]["frames"] == 300


def test_other_groups_of_the_same_port_are_not_heard(tmp_path):
    with (
        multicast(43202, "239.74.163.82") as other,
        multicast(43202) as bus,
        ReaderProcess(tmp_path, f"can:udp_multicast:{GROUP},port=43202") as reader,
    ):
        other.send(message(1))
        bus.send(message(2))
        assert wait_for(lambda: len(reader.frames()) >= 1)
        assert reader.end() == 0
        assert [data for _, _, data in reader.frames()] == [(2).to_bytes(4, "big")]


def test_datagrams_that_are_no_frames_are_counted_and_passed_over(tmp_path):
    with multicast(43203) as bus, ReaderProcess(tmp_path, f"can:udp_multicast:{GROUP},port=43203") as reader:
        raw = bus._multicast
        for junk in (b"", b"x", b"\x81\xa1a\x01", b"\xff" * 2000, NESTED):
            raw.send(junk)
        bus.send(message(7))
        error = reader.wait_event("bus_error")
        assert error["count"] == 5
        assert len(reader.frames()) == 1
        assert reader.end() == 0


def test_frames_that_the_kernel_had_no_room_for_are_counted(tmp_path):
    with multicast(43204) as bus, ReaderProcess(tmp_path, f"can:udp_multicast:{GROUP},port=43204") as reader:
        packed = can.interfaces.udp_multicast.utils.pack_message(message(1))
        reader.process.send_signal(signal.SIGSTOP)
        sent = 40_000
        for _ in range(sent):
            bus._multicast._socket.sendto(packed, (GROUP, 43204))
        reader.process.send_signal(signal.SIGCONT)
        # No frame comes after them that could tell.
        dropped = reader.wait_event("kernel_dropped")["frames"]
        assert wait_for(lambda: len(reader.frames()) + dropped == sent, 15)
        bus.send(message(2))
        assert wait_for(lambda: len(reader.frames()) + dropped == sent + 1)
        assert reader.end() == 0
        assert [e["frames"] for e in reader.events("kernel_dropped")] == [dropped], "told once"


def test_what_is_no_group_is_refused(stop):
    for channel in ("10.0.0.1", "nonsense"):
        with pytest.raises(Unopened, match="expected one such as"):
            CanSocketPort(parse(f"can:udp_multicast:{channel}")).open(stop)


def test_a_killed_reader_has_handed_its_socket_over(tmp_path):
    text = f"can:udp_multicast:{GROUP},port=43205"
    with multicast(43205) as bus:
        with ReaderProcess(tmp_path, text) as reader:
            kept = reader.handed_over()
            bus.send(message(0))
            assert wait_for(lambda: len(reader.frames()) == 1)
            reader.end(signal.SIGKILL)
        for number in range(1, 500):
            bus.send(message(number))
        with ReaderProcess(tmp_path, text, "--adopt", str(kept), pass_fds=(kept,), wait="note") as reader:
            assert wait_for(lambda: len(reader.frames()) == 500)
            assert reader.end() == 0
            assert [data for _, _, data in reader.frames()] == [n.to_bytes(4, "big") for n in range(500)]
            assert [r.before for r in reader.records() if r.kind == RecordKind.CAN] == list(range(500))
        socket.socket(fileno=kept).close()


def test_what_the_kernel_had_no_room_for_while_there_was_no_reader_is_told_by_the_next(tmp_path, stop):
    hand, stores = Hand.make(), []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        stores.append(Store(SpoolWriter(tmp_path / name, "1-a"), lambda *_: None, unit="frames", hand=Hand(hand)))
    first, second = (CanSocketPort(parse(f"can:udp_multicast:{GROUP},port=43206")) for _ in stores)
    first.open(stop)
    stop.ask("it dies")
    first.listen(stores[0], stop)
    sent = 60_000
    with multicast(43206) as bus:
        packed = can.interfaces.udp_multicast.utils.pack_message(message(1))
        for _ in range(sent):
            bus._multicast._socket.sendto(packed, (GROUP, 43206))
    second.adopt(os.dup(first.descriptor()))
    first.close()
    count = None
    while count != stores[1].count:
        count = stores[1].count
        second.listen(stores[1], stop)
    second.close()
    os.close(hand)
    told = [r.event["frames"] for r in stored(tmp_path / "second") if r.kind == RecordKind.EVENT]
    assert len(told) == 1
    assert 0 < count < sent
    assert count + told[0] == sent


# --- python-can -----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def listening(port, store, stop):
    thread = threading.Thread(target=port.listen, args=(store, stop))
    thread.start()
    try:
        yield
    finally:
        stop.ask("over")
        thread.join(20)
        assert not thread.is_alive()


def test_any_interface_of_python_can_is_listened_to(tmp_path, store, stop):
    port = CanLibraryPort(parse("can:virtual:test_reader_can"))
    port.open(stop)
    with can.Bus(interface="virtual", channel="test_reader_can") as bus, listening(port, store, stop):
        for number in range(20):
            bus.send(message(number))
        bus.send(can.Message(arbitration_id=5, is_remote_frame=True, is_extended_id=False))
        assert wait_for(lambda: len([r for r in stored(tmp_path) if r.kind == RecordKind.CAN]) == 21)
        assert wait_for(lambda: stored(tmp_path)[-1].kind == RecordKind.IDLE)
    port.close()
    frames = [r.can for r in stored(tmp_path) if r.kind == RecordKind.CAN]
    assert [data for _, _, data in frames[:20]] == [n.to_bytes(4, "big") for n in range(20)]
    assert frames[20] == (5, CanFlag.REMOTE, b"")


class Broken:
    """A bus that fails so many times."""

    def __init__(self, failures):
        self.failures = failures

    def recv(self, timeout):
        if self.failures:
            self.failures -= 1
            raise can.CanOperationError("nonsense on the line")
        time.sleep(timeout / 50)

    def fileno(self):
        raise NotImplementedError

    def shutdown(self):
        raise RuntimeError("gone already")


def opened_with(bus, monkeypatch, stop):
    monkeypatch.setattr(can, "Bus", lambda **options: bus)
    port = CanLibraryPort(parse("can:virtual:0"))
    port.open(stop)
    return port


def test_an_adapter_that_fails_again_and_again_is_lost(store, stop, monkeypatch):
    port = opened_with(Broken(1000), monkeypatch, stop)
    with pytest.raises(Lost, match="nonsense on the line"):
        port.listen(store, stop)
    port.close()


def test_an_adapter_that_talks_nonsense_now_and_then_is_told_and_listened_to(tmp_path, store, stop, monkeypatch):
    port = opened_with(Broken(5), monkeypatch, stop)
    with listening(port, store, stop):
        assert wait_for(lambda: any(r.kind == RecordKind.EVENT for r in stored(tmp_path)))
    event = next(r.event for r in stored(tmp_path) if r.kind == RecordKind.EVENT)
    assert (event["event"], event["reason"], event["count"]) == ("bus_error", "CanOperationError: nonsense on the line", 5)


class Scripted:
    """A bus that gives frames, as many as it has, and then does something else for good."""

    fileno = shutdown = None

    def __init__(self, frames, then):
        self.frames = list(frames)
        self.then = then

    def recv(self, timeout):
        return self.frames.pop(0) if self.frames else self.then()


@pytest.mark.parametrize("end", [SystemExit, KeyboardInterrupt, GeneratorExit])
def test_what_a_driver_gave_before_it_ends_the_program_is_stored(end, tmp_path, store, stop, monkeypatch):
    def then():
        raise end

    monkeypatch.setattr(signal, "getsignal", lambda number: signal.SIG_IGN)
    monkeypatch.setattr(stop, "wait", lambda seconds: False)
    port = opened_with(Scripted(map(message, range(3)), then), monkeypatch, stop)
    with pytest.raises(Lost, match=end.__name__):
        port.listen(store, stop)
    assert [r.can[2][-1] for r in stored(tmp_path)] == [0, 1, 2]


@pytest.mark.parametrize("data", [bytes(65), bytes(1 << 20), "abc", 10**9], ids=["65", "1 MB", "text", "number"])
def test_a_frame_that_cannot_be_one_is_no_frame(data, tmp_path, store, stop, monkeypatch):
    wrong = message(0)
    wrong.data = data
    port = opened_with(Scripted([], lambda: wrong), monkeypatch, stop)
    with pytest.raises(Lost, match="expected at most 64 data bytes, got"):
        port.listen(store, stop)
    assert not any(r.kind == RecordKind.CAN for r in stored(tmp_path))


def test_an_interface_that_does_not_wait_is_not_asked_without_a_pause(tmp_path, store, stop, monkeypatch):
    asked, slept = [], []

    def then():
        asked.append(1)
        if len(asked) > 5:
            stop.ask("enough")

    port = opened_with(Scripted([], then), monkeypatch, stop)
    monkeypatch.setattr(stop, "wait", slept.append)
    port.listen(store, stop)
    assert len(slept) == 6
    assert set(slept) == {reader_can_library._PAUSE_S}


def test_frames_without_end_are_stored_as_they_come(store, monkeypatch):
    clock = iter(range(0, 10**12, 3_000_000))
    monkeypatch.setattr(reader_can_library.time, "monotonic_ns", lambda: next(clock))
    port = CanLibraryPort(parse("can:virtual:0"))
    port._receive = lambda timeout: message(1)
    port._take(store, 0.05)
    assert 3 <= store.count <= 6


@pytest.mark.parametrize("error", [can.CanInitializationError, SystemExit])
def test_an_interface_that_cannot_be_opened_says_why(error, stop, monkeypatch):
    def refuse(**options):
        raise error("no such adapter")

    monkeypatch.setattr(can, "Bus", refuse)
    with pytest.raises(Unopened, match="no such adapter"):
        CanLibraryPort(parse("can:virtual:0")).open(stop)
    with pytest.raises(UsageError, match="python-can has"):
        CanLibraryPort(parse("can:nonsense:0,bitrate=1")).open(stop)


# --- listening only -------------------------------------------------------------------------------------------------------

#: Where python-can takes the options of the table, beside a parameter of the name.
_ELSEWHERE = {"nixnet": 'kwargs.get("listen_only"', "kvaser": 'kwargs.get("driver_mode"', "systec": 'kwargs.get("state"'}


@pytest.mark.parametrize("interface", LISTEN_ONLY)
def test_python_can_knows_the_options_that_keep_an_interface_silent(interface):
    module, name = can.interfaces.BACKENDS[interface]
    try:
        bus = getattr(importlib.import_module(module), name)
    except Exception as error:
        pytest.skip(f"{module} cannot be imported here: {error}")
    source = inspect.getsource(bus.__init__)
    for option in LISTEN_ONLY[interface].options:
        assert option in inspect.signature(bus.__init__).parameters or _ELSEWHERE[interface] in source


def test_silent_mode_of_kvaser_is_false_in_python_can():
    from can.interfaces.kvaser import canlib

    assert LISTEN_ONLY["kvaser"].options["driver_mode"] is canlib.DRIVER_MODE_SILENT


def test_every_interface_that_python_can_can_silence_is_in_the_table():
    """An interface that learns to listen only in a later python-can shows up here."""
    words = ("listen_only", "monitor:", "DRIVER_SILENT", "MODE_LISTEN_ONLY", '"silent"', "can_lstn_only", "PCAN_LISTEN_ONLY")
    found = set()
    for interface, (module, _) in can.interfaces.BACKENDS.items():
        try:
            source = inspect.getsource(importlib.import_module(module))
        except Exception:
            continue
        if any(word in source for word in words):
            found.add(interface)
    assert found <= LISTEN_ONLY.keys()


def test_what_python_can_is_given():
    options, notes = options_for(parse("can:slcan:/dev/ttyACM0,bitrate=250000,tty_baudrate=2000000"))
    assert options == {
        "interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 250000, "tty_baudrate": 2000000, "listen_only": True,
    }  # fmt: skip
    assert len(notes) == 1
    options, notes = options_for(parse("can:pcan:PCAN_USBBUS1,bitrate=500000,state=active"))
    assert options["state"] == "passive"
    assert any("state=active is ignored" in note for note in notes)
    options, notes = options_for(parse("can:canalystii:0,bitrate=500000"))
    assert options["channel"] == 0
    assert any("acknowledges" in note for note in notes)
    assert options_for(parse("can:virtual:x"))[1] == []


def test_the_passive_state_reaches_python_can_as_its_own(stop, monkeypatch):
    given_options = {}
    monkeypatch.setattr(can, "Bus", lambda **options: given_options.update(options) or Broken(0))
    CanLibraryPort(parse("can:pcan:PCAN_USBBUS1,bitrate=500000")).open(stop)
    assert given_options["state"] is can.BusState.PASSIVE


def test_an_interface_that_takes_part_needs_the_bit_rate():
    with pytest.raises(UsageError, match="bitrate=N"):
        options_for(parse("can:canalystii:0"))
    options, notes = options_for(parse("can:slcan:/dev/ttyACM0"))
    assert options["bitrate"] == 500_000
    assert any("no bitrate given" in note for note in notes)


CAN0 = {
    "ifname": "can0", "flags": ["NOARP", "UP"],
    "linkinfo": {
        "info_kind": "can",
        "info_data": {"ctrlmode": ["LISTEN-ONLY", "BERR-REPORTING"], "state": "ERROR-ACTIVE", "bittiming": {"bitrate": 500000}},
    },
}  # fmt: skip


def test_what_the_kernel_says_of_an_interface():
    assert notes_of_link(CAN0, "can0", 500_000) == []
    assert notes_of_link(CAN0, "can0", None) == []
    assert notes_of_link(CAN0, "can0", 250_000) == ["can0 runs at 500000 bit/s instead of 250000"]
    loud = {**CAN0, "linkinfo": {"info_kind": "can", "info_data": {"bittiming": {"bitrate": 500000}}}}
    assert "listen-only on" in notes_of_link(loud, "can0", 500_000)[0]
    assert notes_of_link({"linkinfo": {"info_kind": "vcan"}}, "vcan0", 500_000) == []
    assert "is unknown" in notes_of_link(None, "can0", None)[0]


def test_the_tool_that_is_asked_answers_for_what_is_there():
    links = links_of(ask_ip())
    assert "no_such_interface" not in links
    assert not links or links["lo"]["ifname"] == "lo"


def test_which_reader_serves_which_endpoint():
    assert isinstance(make_port(parse("can:udp_multicast:239.1.2.3")), CanSocketPort)
    assert isinstance(make_port(parse("can:socketcan:can0,bitrate=500000")), CanSocketPort)
    assert isinstance(make_port(parse("can:socketcan:can0,local_loopback=0")), CanLibraryPort)
    assert isinstance(make_port(parse("can:udp_multicast:239.1.2.3"), plain=True), CanLibraryPort)
    assert isinstance(make_port(parse("can:slcan:x,bitrate=1")), SlcanPort)
    assert not isinstance(make_port(parse("can:slcan:x,bitrate=1"), plain=True), SlcanPort)
    assert type(make_port(parse("can:pcan:x,bitrate=1"))) is CanLibraryPort


def test_what_the_kernel_had_no_room_for_is_told_once_whoever_says_it(tmp_path, store):
    port = CanSocketPort(parse("can:socketcan:can0"))
    for count in (0, 5, 3, 5, 9, 0xFFFFFFFF & (9 - 1)):
        port._tell_overflow(store, count, 1)
    assert [r.event["frames"] for r in stored(tmp_path)] == [5, 4]


# --- slcan ----------------------------------------------------------------------------------------------------------------


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.booleans(), st.booleans(), st.booleans())
def test_a_line_of_an_slcan_adapter_is_understood_as_python_can_understands_it(can_id, data, extended, remote, fd):
    from can.interfaces.slcan import slcanBus

    can_id = can_id if extended else can_id & 0x7FF
    letter = ("dD" if fd else "rR" if remote else "tT")[extended]
    line = f"{letter}{can_id:0{8 if extended else 3}X}{len(data):X}" + ("" if remote and not fd else data.hex().upper())
    theirs = slcanBus.__new__(slcanBus)
    theirs._queue = SimpleQueue()
    theirs._queue.put(line + "\r")
    message, _ = theirs._recv_internal(0)
    found = dissect_line(line.encode())
    assert found[0] == message.arbitration_id
    assert found[2] == bytes(message.data)
    assert bool(found[1] & CanFlag.EXTENDED) == message.is_extended_id
    assert bool(found[1] & CanFlag.REMOTE) == message.is_remote_frame
    assert bool(found[1] & CanFlag.FD) == message.is_fd


@pytest.mark.parametrize("line", [b"t-122AABB", b"t 122AABB", b"t1_22AABB", b"t1232A BB", b"t123+", b"T-00000012AABB"])
def test_a_number_of_an_slcan_line_is_digits_alone(line):
    with pytest.raises(ValueError, match=r"is no frame|breaks off"):
        dissect_line(line)


@given(st.binary(max_size=30))
def test_any_line_is_a_frame_an_answer_or_a_value_error(line):
    with contextlib.suppress(ValueError):
        found = dissect_line(line)
        assert found is None or len(found[2]) <= 64


def told(master, last):
    """All that an adapter is told up to `last`. It comes in pieces, and python-can puts empty lines between."""
    said = b""
    while not said.endswith(last):
        piece = read_from(master, 1)
        assert piece, said
        said += piece
    return said


def test_an_slcan_adapter_is_told_to_listen_only_and_its_frames_are_stored(tmp_path):
    with pty_pair() as (master, path):
        text = f"can:slcan:{path},bitrate=500000,sleep_after_open=0"
        with ReaderProcess(tmp_path, text) as reader:
            said = told(master, b"L\r")
            assert b"S6\r" in said
            # `O` would take part in the bus.
            assert b"O\r" not in said
            frames = [(number % 0x7FF, number.to_bytes(8, "big")) for number in range(3000)]
            stream = b"".join(b"t%03X8%s\r" % (i, data.hex().upper().encode()) for i, data in frames)
            fill(master, b"\r\aV1013\r" + stream[:777])
            assert "answered a setting with an error" in reader.wait_event("note")["text"]
            fill(master, stream[777:] + b"t12\rnonsense\r")
            assert wait_for(lambda: len(reader.frames()) == 3000)
            assert reader.wait_event("bus_error")["count"] == 2
            assert reader.end() == 0
            assert [(i, data) for i, _, data in reader.frames()] == frames
            # The end of listening, as python-can says it to the adapter.
            assert set(told(master, b"C\r").split(b"\r")) <= {b"", b"L", b"C"}


def test_an_slcan_adapter_that_is_unplugged_is_lost(tmp_path):
    with pty_pair() as (_, path):
        reader = ReaderProcess(tmp_path, f"can:slcan:{path},bitrate=500000,sleep_after_open=0")
    with reader:
        assert reader.wait_event("lost")["reason"]


# --- slcan on a pseudo-terminal -------------------------------------------------------------------------------------------


@pytest.fixture
def slcan():
    """The adapter's end of a line, and a port that listens at the other end as pyserial has opened it."""
    serial = pytest.importorskip("serial")
    master, slave = os.openpty()
    with serial.Serial(os.ttyname(slave)) as opened:
        port = SlcanPort(parse("can:slcan:/dev/none"))
        port._number = opened.fileno
        yield master, port
    os.close(slave)
    os.close(master)


def test_frames_of_an_slcan_adapter_are_stored_and_other_lines_counted(tmp_path, slcan, store, stop, monkeypatch):
    monkeypatch.setattr(reader_port, "TICK_NS", 0)
    adapter, port = slcan
    with listening(port, store, stop):
        os.write(adapter, b"t1232AABB\rhello\rT000001231FF\r")
        assert wait_for(lambda: any(r.kind == RecordKind.EVENT for r in stored(tmp_path)))
    records = stored(tmp_path)
    assert [r.can for r in records if r.kind == RecordKind.CAN] == [(0x123, 0, b"\xaa\xbb"), (0x123, CanFlag.EXTENDED, b"\xff")]
    (event,) = [r.event for r in records if r.kind == RecordKind.EVENT]
    assert (event["event"], event["count"]) == ("bus_error", 1)


def test_an_slcan_adapter_that_is_quiet_at_the_end_is_not_lost(tmp_path, slcan, store, stop):
    _, port = slcan
    stop.ask("enough")
    port.listen(store, stop)
    assert not [r for r in stored(tmp_path) if r.kind == RecordKind.EVENT]
