"""`servotap scan` and looking for one drive: who answers, who does not, and what is said about it."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import msgspec
import pytest

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.catalogue import Dialect, Risk, Role, always
from analyzer.cli.signals import ENDING
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.live.endpoint import parse
from analyzer.records import CanFrame, Chunk
from analyzer.values import addresses as addresses_of
from conformance.bus.emulated import EmulatedLine
from conformance.claim import RigFault
from conformance.cli import scan as command
from conformance.drives import make
from conformance.drives.serial_bus import SerialBus
from conformance.gate.gate import Allowance, Gate
from conformance.serve.pty import PtyPort
from conformance.suite.preflight import DriveNotFound, Neighbours, Search, check, find_drive, neighbours
from conformance.talk.scan import Found, Report, Stray, StrayKind, scan, search_read, search_reads
from tests.conformance.drives.served import drives, on_port, on_pty
from tests.diagnosis.spoiled_line import levels, received

SERIAL = [d for d in dialects.every() if d.bus == "serial"]
MKS, MODBUS, LK, CAN = (dialects.get(n) for n in ("mks-rs485", "mks-modbus", "lk-rs485", "mks-can"))


def gate(*names: str, speed: int | None = 38400, **options: Any) -> Gate:
    line = EmulatedLine([make.make(make.parse(name)) for name in names], speed=speed, **options)
    return Gate(line, Allowance())


def names(report: Report) -> list[str]:
    return [f"{found.name} {found.speed}" for found in report.found]


# --- scanning ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_what_is_asked_changes_nothing(dialect: Dialect):
    asked = search_read(dialect)
    assert asked.all_risks == {Risk.READ}
    assert asked.reply_forms


def test_drives_of_all_dialects_at_all_rates():
    found = scan(
        gate("mks-rs485@1", "mks-modbus@2,baud=9600", "lk-rs485@3", "mks-rs485@31"), SERIAL, rates=(38400, 9600, 115200)
    )
    assert names(found) == ["mks-rs485@1 38400", "mks-rs485@31 38400", "mks-modbus@2 9600", "lk-rs485@3 115200"]
    assert found.rates == [38400, 9600, 115200]
    assert found.hints == []
    assert found.found[3].values["temperature"] == 30
    assert found.found[3].identity == "24 V"
    assert 0 < found.found[0].latency_ns < 2_000_000


def test_can_drives_tell_their_type():
    report = scan(gate("mks-can@1", "mks-can@0x7FF,model=57E", speed=500_000), [CAN], addresses=[1, 2, 0x7FF])
    assert names(report) == ["mks-can@1 500000", "mks-can@0x7FF 500000"]
    assert report.found[0].identity == "s42e_can, firmware 1.0.1"
    assert report.found[1].identity.startswith("s57e_can")


@pytest.mark.parametrize(
    "drive",
    ["mks-can@1,fault=reply-under-id-0", "mks-rs485@255,fault=wrong-reply-address", "lk-rs485@32,fault=lk-reply-address-wrong"],
)
def test_a_drive_that_answers_under_an_address_of_no_drive_is_found_where_it_was_asked(drive: str):
    name, _, _ = drive.partition(",")
    dialect, address = dialects.get(name.partition("@")[0]), int(name.partition("@")[2])
    can = dialect.bus == "can"
    asked = gate(drive, speed=500_000 if can else dialect.baud_rates[0] if dialect is LK else 38400)
    found = find_drive(asked, dialect, address).found
    assert found is not None
    assert found.name == name
    assert "it answered for" in found.wrong
    assert [f.name for f in scan(asked, [dialect], addresses=[address]).found] == [name]


def test_nothing_but_reads_leave():
    logged: list[Chunk | CanFrame] = []
    scanned = gate("mks-rs485@1")
    scanned.log = logged.append
    scan(scanned, SERIAL, addresses=range(1, 256))
    sent = [r for r in logged if r.direction is Role.REQUEST]
    assert len(sent) > 255 + 247 + 32
    readings = [r for item in sent for r in gate("mks-rs485@1").interpret(item.data)]
    assert all(r.reads_only for r in readings)


def test_a_scan_leaves_the_line_as_it_was():
    scanned = gate("mks-rs485@1")
    scan(scanned, [MKS], rates=(9600, 115200), addresses=[1])
    assert scanned.line.endpoint.bits_per_second == 38400


def test_what_each_dialect_can_have_is_asked():
    report = scan(gate("mks-rs485@1"), SERIAL, addresses={"mks-rs485": [1], "mks-modbus": [248, 300], "lk-rs485": [33, 0]})
    assert report.asked == 1


def test_it_ends_with_the_first_that_is_enough():
    report = scan(gate("mks-rs485@1", "mks-rs485@2"), [MKS], enough=lambda found: True)
    assert names(report) == ["mks-rs485@1 38400"]


def test_progress_is_told():
    seen: list[tuple[int, int, str]] = []
    scan(gate("mks-rs485@1"), [MKS], addresses=[1, 2], progress=lambda *told: seen.append(told))
    assert seen == [(0, 2, "mks-rs485 at 38400, address 1"), (1, 2, "mks-rs485 at 38400, address 2")]


# --- what is heard and hinted -----------------------------------------------------------------------------------------


def test_silence_has_hints():
    report = scan(gate("mks-rs485@1"), [LK], addresses=[1])
    assert not report.found
    assert not report.strays
    text = " ".join(report.hints)
    for word in ("wiring", "swap", "rate", "mode", "adapter"):
        assert word in text
    assert "termination" in " ".join(scan(gate("mks-can@1", speed=125_000), [CAN], addresses=[1]).hints)


def test_two_drives_of_one_address_are_told():
    crowd = scan(gate("mks-rs485@1", "lk-rs485@1,baud=38400"), SERIAL, addresses=[1])
    assert any("two drives have one address" in hint for hint in crowd.hints)


@pytest.mark.parametrize(
    ("fault", "told"), [("wrong-reply-address", "it answered for"), ("checksum-wrong", "its checksum is wrong")]
)
def test_a_wrong_answer_is_one_and_is_told(fault: str, told: str):
    report = scan(gate(f"mks-rs485@2,fault={fault}"), [MKS], addresses=[2])
    assert told in report.found[0].wrong
    assert any(told in hint for hint in report.hints)


class Scripted(EmulatedLine):
    """A line on which something is heard besides: bytes, once each, at the first moments of listening."""

    def __init__(self, *pieces: bytes) -> None:
        super().__init__([make.make(make.parse("mks-rs485@99"))], speed=38400)
        self.pieces = list(pieces)

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        if self.pieces:
            self.bus.run_until(self.bus.now_ns + 1_000_000)
            return Chunk(self.bus.now_ns, "emulated", self.pieces.pop(0), Role.REPLY)
        return super().receive(timeout_ns)


def heard(*pieces: bytes, **options: Any) -> Report:
    return scan(Gate(Scripted(*pieces), Allowance()), SERIAL, addresses=[1], **options)


def test_a_bus_in_use_is_left_alone():
    request, reply = build(MKS, "read_speed", 5), build(MKS, "read_speed", 5, {}, Role.REPLY)
    report = heard(request, reply)
    assert report.asked == 0
    assert "others speak on this bus" in report.stopped
    assert report.strays[0].kind is StrayKind.REQUEST
    assert "--busy" in report.hints[0]
    assert heard(request, reply, busy=True).asked == 3


def test_what_other_nodes_say_on_can_is_no_drive(monkeypatch: pytest.MonkeyPatch):
    """By chance one frame of theirs fits as a reply does, and from then on the node passes for a drive."""
    bus = gate("mks-can@3", speed=None)
    said = [bytes.fromhex(text) for text in ("F6 01 2C", "FC CF 17 D7 D4 D0 78 45", "32 01 02 03", "31 01 02 03 04 05 06 07")]
    receive, write, waiting = bus.line.receive, bus.line.write, list[bytes]()

    def written(item: bytes | CanFrame) -> int:
        waiting.append(said[bus.sent % len(said)])
        return write(item)

    def received(timeout_ns: int) -> Chunk | CanFrame | None:
        return CanFrame(bus.line.now_ns(), "emulated", 0x235, waiting.pop()) if waiting else receive(timeout_ns)

    monkeypatch.setattr(bus.line, "write", written)
    monkeypatch.setattr(bus.line, "receive", received)
    assert [found.name for found in scan(bus, [CAN], addresses=range(1, 9), busy=True).found] == ["mks-can@3"]


def test_a_low_line_and_noise_are_told_apart():
    low = heard(bytes(20))
    assert low.strays[0].kind is StrayKind.LOW
    assert any("A and B are swapped" in hint for hint in low.hints)
    noise = heard(bytes.fromhex("F8 78 E0 1E 98 66 FE"))
    assert noise.strays[0].kind is StrayKind.WRONG_RATE
    assert any("another rate" in hint for hint in noise.hints)


def test_an_echoing_adapter_is_told(capsys: pytest.CaptureFixture[str]):
    with on_port(SerialBus(drives("mks-rs485@1"), echo=True), PtyPort(speed=38400)) as place:
        assert run(f"serial:{place},baud=38400", "--dialects", "mks-rs485", "--addresses", "1,2") == 0
    out = capsys.readouterr().out
    # A reply that comes late is said beside its drive, with what was asked by then.
    assert re.findall(r"^mks-rs485@\d+", out, re.MULTILINE) == ["mks-rs485@1"]
    assert "hands back what it sends" in out


# --- looking for one drive --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("there", "told"),
    [
        ("mks-rs485@1", "mks-rs485@1 answers at 38400"),
        ("mks-modbus@1", "but mks-modbus@1 does at 38400 bit/s: it speaks another dialect"),
        ("mks-rs485@7", "but mks-rs485@7 does: it has another address"),
        ("mks-rs485@1,baud=9600", "at 9600 bit/s: the line is at another rate than the drive"),
        ("mks-rs485@200", "nothing came"),
    ],
)
def test_where_a_drive_is_instead(there: str, told: str):
    # The gate allows its own drive alone: looking for it elsewhere is reading, and passes all the same.
    line = EmulatedLine([make.make(make.parse(there))], speed=38400)
    search = find_drive(Gate(line, Allowance(addresses=frozenset({1}))), MKS, 1)
    assert told in search.text
    assert (search.found is not None) == (there == "mks-rs485@1")
    assert line.endpoint.bits_per_second == 38400


def test_a_slow_drive_is_waited_for():
    line = EmulatedLine([make.make(make.parse("mks-rs485@1"), reply_delay_ns=700_000_000)], speed=38400)
    assert find_drive(Gate(line, Allowance()), MKS, 1).found


def test_a_late_answer_is_not_taken_for_that_of_the_next_drive():
    # The first drive answers while the second is asked, and the second is there all the same.
    found = scan(gate("mks-rs485@1,latency=50..50ms", "mks-rs485@2,latency=20..20ms"), [MKS], addresses=(1, 2, 3))
    assert sorted(names(found)) == ["mks-rs485@1 38400", "mks-rs485@2 38400"]
    assert [f.wrong for f in found.found if f.address == 2] == [""]
    # Where the second is not there, the first is told, and once.
    found = scan(gate("mks-rs485@1,latency=60..60ms"), [MKS], addresses=(1, 2, 3))
    assert names(found) == ["mks-rs485@1 38400"]
    assert "when mks-rs485@2 was asked" in found.found[0].wrong


# --- the command ------------------------------------------------------------------------------------------------------


def run(*words: str) -> int:
    return analyzer_cli._run("scan", command, words)


@pytest.fixture(scope="module")
def path() -> Iterator[str]:
    with on_pty("mks-rs485@1,baud=19200", "lk-rs485@3,baud=19200") as found:
        yield found


def test_a_port_without_a_rate(path: str, capsys: pytest.CaptureFixture[str]):
    # On a busy machine the emulated drives answer late, and a late reply is taken for one to the next request.
    words = (f"serial:{path}", "--addresses", "1,3", "--timeout", "100")
    assert run(*words, "--rates", "9600,19200") == 0
    out = capsys.readouterr().out
    assert "mks-rs485@1" in out
    assert "19200 bit/s" in out
    assert "lk-rs485@3" in out
    # What to type next stands at the end, at the rate that was found.
    assert out.splitlines()[-2:] == [
        f"  servotap test {name} --on serial:{path},baud=19200 --short" for name in ("mks-rs485@1", "lk-rs485@3")
    ]
    assert f"  servotap record serial:{path},baud=19200 -o week.mcap" in out


def test_hits_are_told_as_they_come(path: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    told: list[str] = []

    def watched(*arguments: Any, **options: Any) -> Report:
        def progress(done: int, total: int, where: str) -> None:
            told.append(capsys.readouterr().out)

        return scan(*arguments, **options | {"progress": progress})

    monkeypatch.setattr(command, "scan", watched)
    assert run(f"serial:{path},baud=19200", "--dialects", "mks-rs485", "--addresses", "1-3") == 0
    assert "mks-rs485@1" in told[1], "before the next address is asked"


def test_json(path: str, capsys: pytest.CaptureFixture[str]):
    assert run(f"serial:{path},baud=19200", "--addresses", "1-3", "--dialects", "lk-rs485", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert [(f["dialect"], f["address"], f["speed"]) for f in found["found"]] == [("lk-rs485", 3, 19200)]
    assert found["asked"] == 3


def test_nothing_found_is_1(path: str, capsys: pytest.CaptureFixture[str]):
    assert run(f"serial:{path},baud=9600", "--addresses", "1", "--timeout", "5") == 1
    out = capsys.readouterr().out
    assert "no drive answered" in out
    assert "wiring" in out


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_shows_what_was_found(
    number: int, path: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def until_three(*arguments: Any, **options: Any) -> Report:
        def stop(done: int, total: int, where: str) -> None:
            if done == 2:
                signal.raise_signal(number)

        return scan(*arguments, **options | {"progress": stop})

    monkeypatch.setattr(command, "scan", until_three)
    assert run(f"serial:{path},baud=19200", "--dialects", "mks-rs485", "--addresses", "1-9") == 128 + number
    out = capsys.readouterr().out
    assert "mks-rs485@1" in out
    assert f"stopped by {ENDING[number]}\n" in out
    assert "end the other host" not in out


@pytest.mark.parametrize(
    ("place", "rate"),
    [("tcp:127.0.0.1:1", "its own rate"), ("tcp:127.0.0.1:1,baud=9600", "9600 bit/s"), ("serial:x", "9600 bit/s")],
)
def test_a_rate_behind_a_terminal_server_is_not_made_up(place: str, rate: str):
    found = Found(LK, 1, 9600, 1_000_000, b"")
    assert command._found_line(found, parse(place)) == f"lk-rs485@1       {rate:>14}    1.00 ms"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("serial:/dev/none",), "is not there"),
        (("tcp:127.0.0.1:1",), "cannot connect"),
        (("serial:x", "--addresses", "0-5"), "--addresses"),
        (("serial:x", "--addresses", "5-1"), "--addresses"),
        (("serial:x", "--rates", "fast"), "--rates"),
        (("serial:x", "--dialects", "mks-can"), "is a dialect of can"),
        (("serial:x", "--dialects", "mks"), "no dialect"),
        (("serial:x", "--timeout", "0"), "--timeout"),
        (("can:nothing:0",), "no CAN interface"),
    ],
)
def test_wrong_use(words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]):
    assert run(*words) == 2
    assert told in capsys.readouterr().err


def test_addresses():
    assert addresses_of("1-3,2,0x10-0x11", "--addresses") == [1, 2, 3, 16, 17]
    with pytest.raises(UsageError):
        addresses_of("1-9999", "--addresses")


@pytest.mark.parametrize("other", ["mks-rs485@60", "mks-rs485@255", "lk-rs485@32,baud=38400", "mks-modbus@247"])
def test_a_drive_at_any_address_is_a_neighbour(other: str):
    both = gate("mks-rs485@1", other)
    assert neighbours(both, SERIAL, own=(1,)) == Neighbours((other.partition(",")[0],))
    with pytest.raises(DriveNotFound, match="answers too"):
        check(both, dialects.get("mks-rs485"), 1, alone=True)


@pytest.mark.parametrize(
    "other", ["mks-rs485@60,latency=4..4ms", "mks-rs485@60,latency=30..30ms", "mks-modbus@247,latency=8..8ms"]
)
def test_a_neighbour_is_found_whose_late_answer_collides_with_a_question(other: str):
    both = gate("mks-rs485@1", other)
    assert neighbours(both, SERIAL, own=(1,)) == Neighbours((other.partition(",")[0],))


def test_a_drive_at_any_identifier_is_a_neighbour():
    both = gate("mks-can@1", "mks-can@0x7CF", speed=None)
    assert neighbours(both, [dialects.get("mks-can")], own=(1,)) == Neighbours(("mks-can@0x7CF",))


def test_all_addresses_are_looked_at_within_seconds():
    one = gate("mks-rs485@1")
    begun_ns = one.now_ns()
    assert neighbours(one, SERIAL, own=(1,)) == Neighbours()
    assert one.now_ns() - begun_ns < 4_000_000_000


def with_another(dialect: Dialect, reads: int | None = None) -> list[Dialect]:
    """Return a dialect and one of the same bus to whose drives each question is a motion."""
    codes = {c.code for c in search_reads(dialect)[:reads]}
    risky = tuple(replace(c, risk=(always(Risk.MOTION),)) if c.code in codes else c for c in dialect.commands)
    return [dialect, replace(dialect, name="another", commands=risky)]


@pytest.mark.parametrize("name", ["mks-rs485@1", "mks-can@1"])
def test_alone_is_not_granted_where_an_address_cannot_be_looked_at(name: str, monkeypatch: pytest.MonkeyPatch):
    line = EmulatedLine([make.make(make.parse(name))])
    dialect = dialects.drive(name)[0]
    both = with_another(dialect)
    asking = Gate(line, Allowance(), dialects=both)
    near = neighbours(asking, [dialect], own=(1,))
    assert near.names == ()
    assert len(near.unasked) == dialect.addresses[1] - dialect.addresses[0]
    assert near.unasked[0] == f"{dialect.name}@2"
    monkeypatch.setattr(
        "conformance.suite.preflight.find_drive",
        lambda *_: Search(None, (), "", Report(strays=[Stray(1, "", b"x", StrayKind.LOW)])),
    )
    with pytest.raises(DriveNotFound, match=r"@9 and \d+ more cannot be looked for"):
        check(asking, dialect, 1, alone=True)


@pytest.mark.parametrize("name", ["mks-rs485@1", "mks-can@1"])
def test_another_read_asks_where_the_best_would_do_something_to_another_dialect(name: str):
    dialect, other = dialects.drive(name)[0], name.replace("@1", "@9")
    asking = Gate(
        EmulatedLine([make.make(make.parse(n)) for n in (name, other)]), Allowance(), dialects=with_another(dialect, 1)
    )
    assert neighbours(asking, [dialect], own=(1,)) == Neighbours((other,))


def test_who_says_what_is_spoken_is_asked_in_that_alone():
    both = gate("mks-rs485@1", "lk-rs485@5,baud=38400")
    assert check(both, MKS, 1, alone=True, spoken=frozenset({"mks-modbus"})) == ""
    with pytest.raises(DriveNotFound, match="lk-rs485@5 answers too"):
        check(both, MKS, 1, alone=True, spoken=frozenset({"lk-rs485"}))


class Inverted(EmulatedLine):
    """A line with A and B swapped at the host's end of what it receives."""

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        item = super().receive(timeout_ns)
        if not isinstance(item, Chunk):
            return item
        return Chunk(item.t_ns, item.port, received(levels(item.data), inverted=True), item.direction)


def test_bytes_that_are_no_answer_are_diagnosed(capsys: pytest.CaptureFixture[str]):
    line = Inverted([make.make(make.parse("mks-rs485@1"))], speed=38400)
    report = scan(Gate(line, Allowance()), [MKS], addresses=[1, 2])
    assert report.diagnosis is not None
    assert report.diagnosis.causes[0].suspicion.cause == "inverted_lines"
    found = find_drive(Gate(line, Allowance()), MKS, 1)
    assert "(inverted_lines," in found.text
    command.show(report, line.endpoint)
    assert "(inverted_lines," in capsys.readouterr().out
    assert heard().diagnosis is None


class Behind(EmulatedLine):
    """A line that keeps each reply until the next one comes."""

    kept: Chunk | CanFrame | None = None

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        got = super().receive(timeout_ns)
        if got is None:
            return None
        kept, self.kept = self.kept, got
        return kept and msgspec.structs.replace(kept, t_ns=got.t_ns)


@pytest.mark.parametrize("line", [EmulatedLine, Behind])
@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_a_drive_that_is_always_one_reply_behind_is_told_at_once(dialect, line):
    own = Gate(line([make.make(make.parse(f"{dialect.name}@1"))]), Allowance())
    if line is EmulatedLine:
        check(own, dialect, 1, alone=False)
        return
    with pytest.raises(RigFault, match="answers each question with its reply to the one before: nothing can be judged"):
        check(own, dialect, 1, alone=False)
    assert own.now_ns() < 10_000_000_000
