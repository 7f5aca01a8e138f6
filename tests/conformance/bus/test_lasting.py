"""A line whose port goes and comes back, with lines and a clock of the test."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from analyzer.errors import UsageError
from analyzer.live import endpoint as endpoints
from conformance.bus import lasting
from conformance.bus.can_port import Acceptance
from conformance.bus.lasting import BACK_SECONDS, LastingLine, identity
from conformance.bus.line import LineLost


class Port:
    """Where lines are opened, with a clock. `there`: from when on one can be opened; `opened`: endpoints, in order."""

    def __init__(self) -> None:
        self.now, self.there = 0.0, 0.0
        self.opened, self.closed, self.sent = [], 0, []
        self.adapter = "A5"

    def open_line(self, endpoint):
        if self.now < self.there:
            raise UsageError("no such port")
        self.opened.append(endpoint.text)
        return Within(self, endpoint)

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class Within:
    """A line that fails once its port has gone."""

    anchor_ns = 0
    acceptance = None

    def __init__(self, port, endpoint):
        self.port, self.endpoint, self.works = port, endpoint, True

    def write(self, item):
        if not self.works:
            raise LineLost("the port is gone")
        self.port.sent.append(item)
        return 0

    def receive(self, timeout_ns):
        self.write(b"")

    def set_speed(self, bits_per_second):
        self.endpoint = self.endpoint.at(bits_per_second)

    def close(self):
        self.port.closed += 1


def adapter(number, **more):
    return SimpleNamespace(
        **{"device": "/dev/x", "vid": 0x403, "pid": 0x6001, "serial_number": number, "location": "1-2"} | more
    )


@pytest.fixture
def port(monkeypatch):
    port = Port()
    monkeypatch.setattr(lasting, "open_line", port.open_line)
    monkeypatch.setattr(lasting, "time", port)
    monkeypatch.setattr(lasting.list_ports, "comports", lambda: [adapter(port.adapter)] if port.adapter else [])
    return port


def lost_line(port, *, moving, away):
    """Return a line whose port went just now and is back in `away` seconds."""
    line = LastingLine(endpoints.parse("serial:/dev/x,baud=38400"), lambda: moving)
    line.set_speed(115200)
    line._line.works = False
    port.there = port.now + away
    with pytest.raises(LineLost, match="the port is gone"):
        line.write(b"a")
    assert line.lost
    assert port.closed == 1
    return line


def test_the_next_write_opens_it_anew_at_the_speed_that_it_had(port):
    line = lost_line(port, moving=False, away=0)
    line.write(b"b")
    assert not line.lost
    assert port.sent == [b"b"]
    assert port.opened == ["serial:/dev/x,baud=38400", endpoints.parse("serial:/dev/x,baud=38400").at(115200).text]
    assert line.endpoint.bits_per_second == 115200


@pytest.mark.parametrize("act", [lambda line: line.write(b"b"), lambda line: line.receive(0)], ids=["write", "receive"])
def test_while_a_motor_may_turn_it_is_waited_for(port, act):
    line = lost_line(port, moving=True, away=BACK_SECONDS - 1)
    act(line)
    assert BACK_SECONDS - 1 <= port.now < BACK_SECONDS


def test_it_is_not_waited_for_where_all_stands(port):
    line = lost_line(port, moving=False, away=1)
    with pytest.raises(LineLost, match="the port is gone, and it is not back: no such port"):
        line.write(b"b")
    assert port.now == 0


def test_a_port_that_stays_away_holds_up_nothing_twice(port):
    line = lost_line(port, moving=True, away=1e9)
    for _ in range(3):
        with pytest.raises(LineLost, match="not back"):
            line.write(b"b")
    assert BACK_SECONDS <= port.now < BACK_SECONDS + 1
    port.there = 0
    line.write(b"b")
    assert port.sent == [b"b"]


def test_one_that_goes_again_is_waited_for_again(port):
    line = lost_line(port, moving=True, away=1)
    line.write(b"b")
    line._line.works, port.there = False, port.now + 2
    with pytest.raises(LineLost):
        line.write(b"c")
    line.write(b"d")
    assert port.sent == [b"b", b"d"]


def test_another_adapter_that_gets_the_name_is_sent_nothing(port):
    line = lost_line(port, moving=True, away=0)
    port.adapter = "B6"
    with pytest.raises(LineLost, match="no port with its identity is there"):
        line.write(b"stop")
    assert len(port.opened) == 1
    port.adapter = "A5"
    line.write(b"stop")
    assert port.sent == [b"stop"]


def test_a_port_that_cannot_be_told_from_others_is_tried_as_it_is(port):
    port.adapter = ""
    line = LastingLine(endpoints.parse("serial:/dev/pts/1,baud=38400"), lambda: True)
    line._line.works = False
    with pytest.raises(LineLost):
        line.write(b"a")
    line._line.works = True
    line.write(b"b")
    assert (line.lost, port.closed, len(port.opened), port.sent, port.now) == (False, 0, 1, [b"b"], 0)


@pytest.mark.parametrize(
    ("text", "there", "told"),
    [
        ("tcp:10.0.0.7:5000", None, "10.0.0.7:5000"),
        ("serial:,serial=A5,baud=38400", None, "A5"),
        ("serial:/dev/x,baud=38400", adapter("A5"), "0403:6001 A5 1-2"),
        ("serial:/dev/x,baud=38400", adapter(None), "0403:6001  1-2"),
        ("serial:/dev/x,baud=38400", adapter("A5", device="/dev/y"), ""),
        ("serial:/dev/x,baud=38400", adapter(None, vid=None), ""),
        ("can:slcan:/dev/ttyACM0", None, ""),
    ],
)
def test_what_tells_a_port_from_others(text, there, told, monkeypatch):
    monkeypatch.setattr(lasting.list_ports, "comports", lambda: [there] if there else [])
    assert identity(endpoints.parse(text)) == told


def test_a_link_means_one_port(tmp_path, monkeypatch):
    link = tmp_path / "arm"
    link.symlink_to(tmp_path / "port")
    monkeypatch.setattr(lasting.list_ports, "comports", list)
    assert identity(endpoints.parse(f"serial:{link},baud=38400")) == str(link)


@pytest.mark.parametrize("linked", [False, True], ids=["a name", "a link"])
def test_ports_that_share_a_serial_number_are_told_apart(linked, tmp_path, monkeypatch):
    """Four ports of one adapter, and adapters that all have the number 0001: names and links go to the next that comes."""
    place = tmp_path / "port"
    if linked:
        (tmp_path / "link").symlink_to(place)
    endpoint = endpoints.parse(f"serial:{tmp_path / 'link' if linked else place},baud=38400")
    seen = set()
    for location in ("1-2:1.0", "1-2:1.1", "1-3"):
        monkeypatch.setattr(
            lasting.list_ports, "comports", lambda at=location: [adapter("0001", device=str(place), location=at)]
        )
        seen.add(identity(endpoint))
    assert len(seen) == 3


def test_an_adapter_that_gets_the_name_while_it_is_opened_is_sent_nothing(port, monkeypatch):
    line = lost_line(port, moving=False, away=0)

    def swapped(endpoint):
        port.adapter = "B6"
        return port.open_line(endpoint)

    monkeypatch.setattr(lasting, "open_line", swapped)
    with pytest.raises(LineLost, match="no port with its identity is there"):
        line.write(b"stop")
    assert (port.sent, port.closed, line.lost) == ([], 2, True)


def test_what_is_read_of_a_bus_is_that_of_the_line_within(port):
    line = LastingLine(endpoints.parse("serial:/dev/x,baud=38400"), lambda: False)
    line._line.acceptance = Acceptance()
    assert line.acceptance is line._line.acceptance
