"""The rate of a line, found by listening: with the bytes that a UART makes of it at every other rate."""

from __future__ import annotations

import os
import random
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.catalogue import Dialect, Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.live.autobaud import decide, judge, rates, score, search, table
from analyzer.live.autobaud_ports import find, listener_for
from analyzer.live.endpoint import parse
from analyzer.records import Chunk
from conformance.drives.uart import BITS, SECOND_NS, SentBytes, hear
from conformance.serve.line_speed import line_speed
from tests.live.recorded import Recorded
from tests.logs import metadata

SERIAL = [d for d in dialects.every() if d.bus == "serial"]
ENDPOINT = parse("left=serial:/dev/ttyUSB0,baud=auto")
MS = 1_000_000


def exchange(name: str, n: int) -> tuple[bytes, bytes]:
    """A request and its reply, other values each time."""
    dialect = dialects.get(name)
    speed = random.Random(n).randint(-3000, 3000)
    if name == "lk-rs485":
        values = {"temperature": 31, "torque_current": speed % 800, "speed": speed, "encoder": n * 37 % 65536}
        read = "read_state_2"
    else:
        values, read = {"speed": speed}, "read_speed"
    return build(dialect, read, 1), build(dialect, read, 1, values, Role.REPLY)


def line(name: str, baud: int, count: int = 30) -> list[SentBytes]:
    """What a host and a drive put on a line, in turn."""
    sent, at = [], 0
    for n in range(count):
        for data in exchange(name, n):
            sent.append(SentBytes(at, baud, data))
            at += len(data) * BITS * SECOND_NS // baud + 4 * MS
    return sent


def heard(sent: Sequence[SentBytes], rate: int) -> list[Chunk]:
    """What an adapter set to a rate makes of it, in the lumps that it comes in."""
    chunks: list[Chunk] = []
    for t_ns, byte in hear(sent, rate):
        if chunks and t_ns - (chunks[-1].t_ns or 0) < 2 * MS:
            last = chunks.pop()
            chunks.append(Chunk(t_ns, "line", last.data + bytes((byte,))))
        else:
            chunks.append(Chunk(t_ns, "line", bytes((byte,))))
    return chunks


class Wire:
    """An ear on a line. `lines`: what is on it, one for each time that it is listened to, the last one from then on."""

    def __init__(self, *lines: Sequence[SentBytes]) -> None:
        self._lines = list(lines)
        self.rates: list[int] = []

    def listen(self, rate: int, seconds: float, enough: Callable[[Sequence[Chunk]], bool]) -> Sequence[Chunk]:
        self.rates.append(rate)
        sent = self._lines.pop(0) if len(self._lines) > 1 else self._lines[0]
        chunks: list[Chunk] = []
        for chunk in heard(sent, rate):
            chunks.append(chunk)
            if enough(chunks):
                break
        return chunks

    def close(self) -> None:
        pass


def test_the_most_usual_rates_come_first() -> None:
    order = rates(SERIAL)
    assert order[:4] == [38400, 115200, 9600, 19200]
    assert sorted(order) == sorted({rate for d in SERIAL for rate in d.baud_rates})
    assert rates([dialects.get("lk-rs485")])[0] == 115200


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus", "lk-rs485"])
def test_every_rate_of_every_dialect_is_found_among_what_the_others_make_of_it(name: str) -> None:
    dialect = dialects.get(name)
    for baud in dialect.baud_rates:
        sent = line(name, baud, 12)
        listened = {rate: heard(sent, rate) for rate in rates(SERIAL)}
        found = score(listened, SERIAL)
        assert decide(found).rate == baud
        assert found[0].best is not None
        assert found[0].best.dialect is dialect
        assert found[0].share == 1.0
        others = [h for h in found if h.rate != baud]
        assert all(h.share < 0.2 for h in others), table(found)
        assert any(h.bytes for h in others)


def test_the_search_ends_when_a_rate_leaves_no_doubt() -> None:
    wire = Wire(line("mks-rs485", 9600))
    said: list[str] = []
    found = search(ENDPOINT, wire, SERIAL, say=said.append)
    assert (found.endpoint.speed, found.endpoint.auto, found.endpoint.name) == (9600, False, "left")
    assert [d.name for d in found.dialects] == ["mks-rs485"]
    assert wire.rates == [38400, 115200, 9600]
    assert said[0].startswith("38400 baud:")
    assert "9600" in said[-1]
    assert "mks-rs485" in said[-1]
    rows = [text.split() for text in said if text.strip()[:1].isdigit() and "baud" not in text]
    assert [row[0] for row in rows] == ["9600", "38400", "115200"]
    assert rows[0][3:] == ["100", "%", "mks-rs485"]


def test_two_dialects_on_one_line_are_both_named() -> None:
    sent = []
    for n, (a, b) in enumerate(zip(line("mks-rs485", 115200, 20), line("lk-rs485", 115200, 20), strict=True)):
        sent += [SentBytes(n * 20 * MS, 115200, a.data), SentBytes(n * 20 * MS + 10 * MS, 115200, b.data)]
    found = search(ENDPOINT, Wire(sent), SERIAL)
    assert found.endpoint.speed == 115200
    assert {d.name for d in found.dialects} == {"mks-rs485", "lk-rs485"}


def test_a_quiet_line_is_said_to_be_quiet() -> None:
    with pytest.raises(UsageError, match="no traffic at any rate"):
        search(ENDPOINT, Wire([]), SERIAL)


def test_bytes_that_never_frame_are_told_apart_from_silence() -> None:
    noise = random.Random(1).randbytes(3000)
    with pytest.raises(UsageError, match=r"at no rate do they form frames.*parity"):
        search(ENDPOINT, Wire([SentBytes(0, 38400, noise)]), SERIAL)


def test_a_line_that_changes_its_rate_is_not_clear() -> None:
    few = {rate: heard(line("mks-rs485", rate, 5), rate) for rate in (38400, 9600)}
    with pytest.raises(UsageError, match=r"not clear: 38400 baud explains 100 %.*9600"):
        decide(score(few, SERIAL))


def test_few_frames_are_not_believed() -> None:
    assert not judge(38400, heard(line("mks-rs485", 38400, 1), 38400), SERIAL).believed
    assert judge(38400, heard(line("mks-rs485", 38400, 2), 38400), SERIAL).believed


def test_a_rate_at_which_little_was_heard_gets_a_second_turn() -> None:
    sent = line("mks-modbus", 19200, 4)
    turns = len(rates(SERIAL))
    # There is traffic in the first turn at the first rate only, and then from the second turn on.
    wire = Wire(line("mks-modbus", 19200, 1), *[[]] * (turns - 1), sent)
    found = search(ENDPOINT, wire, SERIAL)
    assert found.endpoint.speed == 19200
    assert wire.rates.count(19200) == 2


def test_only_the_rates_of_the_dialects_that_are_allowed() -> None:
    wire = Wire([])
    with pytest.raises(UsageError, match="no traffic"):
        search(ENDPOINT, wire, [dialects.get("mks-rs485")])
    assert set(wire.rates) == set(dialects.get("mks-rs485").baud_rates)


# --- on a port ------------------------------------------------------------------------------------------------------


class Talker:
    """A pseudo-terminal that hears the rate it is set to and says what an adapter would hear of a line at that rate."""

    def __init__(self, name: str, baud: int) -> None:
        self._master, self._slave = os.openpty()
        self.path = os.ttyname(self._slave)
        self._sent = line(name, baud, 8)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._talk)
        self._thread.start()

    def _talk(self) -> None:
        made: dict[int, list[bytes]] = {}
        os.set_blocking(self._master, False)
        while not self._ended.is_set():
            speed = line_speed(self._slave) or 0
            if speed not in made:
                made[speed] = [c.data for c in heard(self._sent, speed)]
            for data in made[speed]:
                if self._ended.wait(0.002) or line_speed(self._slave) != speed:
                    break
                try:
                    os.write(self._master, data)
                except BlockingIOError:
                    # No process listens.
                    continue

    def close(self) -> None:
        self._ended.set()
        self._thread.join(5)
        os.close(self._slave)
        os.close(self._master)


def serial_only(name: str) -> list[Dialect]:
    return [dialects.get(name)]


def test_a_real_port_is_listened_to_at_one_rate_after_the_other() -> None:
    talker = Talker("mks-rs485", 19200)
    try:
        said: list[str] = []
        found = find(parse(f"serial:{talker.path},baud=auto"), seconds=0.4, say=said.append)
        assert found.endpoint.speed == 19200
        assert found.endpoint.place == talker.path
        only = find(parse(f"serial:{talker.path},baud=auto"), seconds=0.4, candidates=serial_only("mks-rs485"))
        assert only.endpoint.speed == 19200
    finally:
        talker.close()


def test_record_finds_the_rate_and_says_how(tmp_path: Path) -> None:
    talker = Talker("mks-rs485", 115200)
    try:
        with Recorded(tmp_path, f"left=serial:{talker.path},baud=auto") as recorded:
            assert recorded.wait_bytes(500)
            assert recorded.end() == 0
    finally:
        talker.close()
    values = metadata(recorded.log)
    assert values["bus.left.baud"] == "115200"
    assert "115200 baud, mks-rs485" in values["notes"]


def test_the_same_through_pyserial() -> None:
    talker = Talker("mks-rs485", 115200)
    try:
        endpoint = parse(f"serial:{talker.path},baud=auto")
        assert search(endpoint, listener_for(endpoint, 38400, plain=True), SERIAL, seconds=0.4).endpoint.speed == 115200
    finally:
        talker.close()
    with pytest.raises(UsageError, match="serial:/dev/none"):
        search(parse("serial:/dev/none"), listener_for(parse("serial:/dev/none"), 38400, plain=True), SERIAL)


def test_a_port_that_cannot_be_opened() -> None:
    with pytest.raises(UsageError, match=r"/dev/none.*not there"):
        find(parse("serial:/dev/none,baud=auto"))
    with pytest.raises(UsageError, match="is for serial ports"):
        find(parse("tcp:127.0.0.1:5000"))


def test_a_port_that_hangs_up() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    timer = threading.Timer(0.3, lambda: (os.close(slave), os.close(master)))
    timer.start()
    try:
        with pytest.raises(UsageError, match=r"disconnected|lost"):
            find(parse(f"serial:{path},baud=auto"), seconds=5.0)
    finally:
        timer.join()
