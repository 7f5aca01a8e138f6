"""What comes faster than any line: it is left out, counted, and holds up nothing."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from conformance.bus.stream import FLOOD, SECOND_NS, Intake
from conformance.gate.gate import Allowance, Gate
from conformance.safety import stopping
from conformance.suite.preflight import DriveNotFound, check
from tests.conformance.bus.flooded import MS, Flooded
from tests.conformance.cli.test_stop import run

MKS = dialects.get("mks-rs485")
#: What a drive says that stands, of which a server may send more than any line brings.
STANDS = build(MKS, "read_speed", 1, {"speed": 0}, Role.REPLY)
BYTES = {"valid": STANDS, "noise": bytes(range(3, 256, 7))}
BRINGS = 3840


def taken(intake: Intake, *, seconds: int, a_second: int, begin_ns: int = 0, brings: int = BRINGS) -> int:
    """Return how many bytes are read of so many a second, which come at 100 looks a second."""
    looks = 100 * seconds
    return sum(intake.take(begin_ns + n * SECOND_NS // 100, a_second // 100, brings) for n in range(1, looks + 1))


@pytest.mark.parametrize("a_second", [BRINGS, 10 * BRINGS, FLOOD])
def test_what_a_line_or_a_drive_without_one_brings_is_read_whole(a_second: int):
    intake = Intake()
    assert taken(intake, seconds=60, a_second=a_second) == 6000 * (a_second // 100)
    assert intake.left_out == 0


def test_what_no_line_brings_is_read_at_the_rate_of_the_line_and_counted():
    intake = Intake()
    read = taken(intake, seconds=60, a_second=10 * FLOOD)
    assert 59 * BRINGS < read <= 2 * FLOOD + 60 * BRINGS
    assert read + intake.left_out == 600 * FLOOD


def test_a_fast_line_brings_more():
    intake = Intake()
    assert taken(intake, seconds=10, a_second=400_000, brings=400_000) == 4_000_000
    assert intake.left_out == 0


def test_what_waited_for_a_second_is_read_whole():
    intake = Intake()
    intake.take(0, 100, BRINGS)
    assert intake.take(SECOND_NS, FLOOD, BRINGS) == FLOOD


def test_a_line_is_read_as_before_once_the_flood_has_been_over_for_a_second():
    intake = Intake()
    taken(intake, seconds=3, a_second=10 * FLOOD)
    left_out = intake.left_out
    taken(intake, seconds=2, a_second=BRINGS // 2, begin_ns=3 * SECOND_NS)
    assert intake.left_out == left_out
    assert taken(intake, seconds=10, a_second=FLOOD // 2, begin_ns=5 * SECOND_NS) == 5 * FLOOD
    assert intake.left_out == left_out


@pytest.mark.parametrize("what", BYTES)
def test_waiting_on_a_flooded_line_ends_in_time(what: str):
    line = Flooded(BYTES[what])
    came = line.wait(10 * SECOND_NS)
    assert line.now_ns() <= 10 * SECOND_NS + 20 * MS
    assert sum(len(item.data) for item in came) <= FLOOD + 10 * BRINGS + 100
    assert max(len(item.data) for item in came) <= 4096
    assert line.passed > 10 * FLOOD


@pytest.mark.parametrize("place", ["tcp:127.0.0.1:1", "tcp:127.0.0.1:1,baud=38400"])
@pytest.mark.parametrize("what", BYTES)
def test_a_stop_on_a_flooded_line_reaches_all_at_once_and_ends(what: str, place: str, monkeypatch, capsys):
    lines = list[Flooded]()

    def opened(endpoint: object) -> Flooded:
        lines.append(Flooded(BYTES[what], place))
        return lines[-1]

    monkeypatch.setattr("conformance.bus.lasting.open_line", opened)
    assert run(place, "--addresses", "1-4") == 20
    (line,) = lines
    told = capsys.readouterr().err
    assert "NOT STOPPED" in told
    assert "and a line of 38400 bit/s brings 3840" in told
    first = {data: t_ns for t_ns, data in reversed(line.written)}
    for dialect in (d for d in dialects.every() if d.bus == "serial"):
        for address in range(1, 5) if dialect.broadcast is None else (dialect.broadcast,):
            for command in stopping.ramped_stops(dialect):
                assert first[build(dialect, command.name, address, stopping._gentle(command))] < SECOND_NS
    # So long for a drive that seems to be there, and so long for each address that is asked in three dialects.
    assert line.now_ns() < (30 + 4 * 3) * SECOND_NS


def test_a_drive_on_a_flooded_line_is_not_tested():
    for data in BYTES.values():
        line = Flooded(data)
        with pytest.raises(DriveNotFound, match=r"mks-rs485@1 cannot be asked on .*a line of 38400 bit/s brings 3840"):
            check(Gate(line, Allowance()), MKS, 1, alone=False)
        assert line.now_ns() < SECOND_NS
        assert line.written == []
