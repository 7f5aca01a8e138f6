"""The engine of exchanges: what was sent here, replies, other frames and junk are kept apart, and listening ends in time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import pytest

from analyzer import dialects
from analyzer.catalogue import Risk, Role, Verb
from analyzer.encoder import build
from analyzer.errors import PluginError
from analyzer.link import guarded
from analyzer.records import CanFrame, Chunk
from conformance import claims as registry
from conformance.bus.emulated import EmulatedLine
from conformance.drives import make
from conformance.gate.gate import Allowance, Gate, Refused
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk import reply_match
from conformance.talk.dialogue import MS, PAIRED, Dialogue, Until
from conformance.talk.exchange import Completion, Exchange
from conformance.talk.no_checksum import BareReplies

MKS, LK = dialects.get("mks-rs485"), dialects.get("lk-rs485")
READ = build(MKS, "read_speed", 1)
OTHER_REPLY = build(MKS, "read_speed", 9, {}, Role.REPLY)
MOVE = build(MKS, "move_relative_axis", 1, {"speed": 600, "acceleration": 250, "position": 4096})


class Line(EmulatedLine):
    """A line on which other bytes come first, one piece at a time."""

    def __init__(self, *pieces: bytes, drive: str = "mks-rs485@1,work_mode=sr_vfoc", **options: Any) -> None:
        super().__init__([make.make(make.parse(drive), **options)], speed=38400)
        self.pieces = list(pieces)

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        if self.pieces:
            self.bus.run_until(self.bus.now_ns + MS)
            return Chunk(self.bus.now_ns, "emulated", self.pieces.pop(0), Role.REPLY)
        return super().receive(timeout_ns)


def dialogue(*pieces: bytes, log: Any = None, allow: frozenset[Risk] = frozenset(Risk), **options: Any) -> Dialogue:
    return Dialogue(Gate(Line(*pieces, **options), Allowance(allow)), [MKS, LK], log=log)


def took_ms(exchange: Exchange) -> float:
    return (exchange.until_ns - exchange.sent_ns) / MS


def test_what_was_sent_what_answers_it_and_what_does_not_are_kept_apart():
    exchange = dialogue(OTHER_REPLY, b"\0\x55").ask(READ, 500 * MS)
    assert [e.message.frame.data for e in exchange.requests] == [READ]
    assert [a.data for a in exchange.others] == [OTHER_REPLY]
    assert [(a.message.address, a.meaning) for a in exchange.replies] == [(1, "final")]
    assert b"".join(j.data for j in exchange.junk) == b"\0\x55"
    assert exchange.received == OTHER_REPLY + b"\0\x55" + exchange.replies[0].data
    assert exchange.completion is Completion.DONE


def test_a_dialect_that_cannot_be_read_is_no_silent_drive(capsys):
    class Wrong(type(MKS.link)):
        def parse(self, frame, can_id=None):
            raise ValueError("no")

    added = replace(MKS, name="added", link=guarded("added", Wrong(MKS.link.heads)))
    talk = Dialogue(Gate(Line(), Allowance(frozenset(Risk))), [added])
    with pytest.raises(PluginError, match="cannot be read: ValueError: no"):
        talk.ask(READ, 500 * MS)
    assert capsys.readouterr().err == "servotap: added failed and is left out: ValueError: no\n"


class StoodStill(Line):
    """A line on which this process stands still while it waits for the first time, until long after every deadline."""

    still = True

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        if self.still:
            self.still = False
            self.bus.run_until(self.bus.now_ns + 2000 * MS)
            return None
        return super().receive(timeout_ns)


def test_what_came_while_this_process_stood_still_came_in_time():
    talk = Dialogue(Gate(StoodStill(), Allowance(frozenset(Risk))), [MKS])
    assert talk.ask(READ, 500 * MS).completion is Completion.DONE
    # Others that send without end do not keep it from ending.
    flooded = Dialogue(Gate(StoodStill(*[b"\x55"] * 2000), Allowance(frozenset(Risk))), [MKS])
    assert took_ms(flooded.ask(READ, 500 * MS)) < 2500


@pytest.mark.parametrize("size", [1, 4096, 1 << 16])
def test_what_is_read_behind_a_deadline_has_a_bound_whatever_the_size_of_its_pieces(size):
    line = StoodStill(*[OTHER_REPLY[:size].ljust(size, b"\x55")] * 2000)
    Dialogue(Gate(line, Allowance(frozenset(Risk))), [MKS]).ask(READ, 500 * MS)
    pieces = 2000 - len(line.pieces)
    # On top: the piece that passes the bound, and what comes, one a millisecond, while a frame that has begun may be ended.
    at_38400_baud = 3840 * 3
    assert pieces <= min(256, at_38400_baud // size + 2) + 60


def test_listening_ends_with_the_reply_or_with_the_time():
    assert took_ms(dialogue().ask(READ, 500 * MS)) < 50
    silent = dialogue(drive="mks-rs485@7").ask(READ, 500 * MS)
    assert took_ms(silent) == 500
    assert silent.completion is Completion.SILENT
    assert silent.silent


def test_the_quiet_behind_a_reply_is_listened_to():
    quick, quiet = (took_ms(dialogue().ask(READ, 500 * MS, quiet_ns=ns)) for ns in (0, 60 * MS))
    assert quiet == pytest.approx(quick + 60)


@pytest.mark.parametrize(
    ("until", "done_ns", "completion"),
    [
        (Until.REPLY, 0, Completion.RUNNING),
        (Until.DONE, 5000 * MS, Completion.DONE),
        # Without a longer time for what has begun, the time-out holds.
        (Until.DONE, 0, Completion.RUNNING),
    ],
)
def test_a_command_that_tells_its_end(until: Until, done_ns: int, completion: Completion):
    exchange = dialogue().ask(MOVE, 100 * MS, until=until, done_ns=done_ns)
    assert exchange.completion is completion


def test_a_late_reply_is_known_in_the_next_exchange():
    talk = dialogue(reply_delay_ns=80 * MS)
    assert talk.ask(READ, 20 * MS).silent
    later = talk.listen(200 * MS)
    assert [a.paired for a in later.answers] == [True]
    assert later.sent is None


def test_what_the_analyzer_is_not_shown_has_no_replies():
    talk = dialogue()
    exchange = talk.send(READ, shown=False)
    talk.collect(exchange, lambda found, new: bool(new), 500 * MS)
    assert [a.paired for a in exchange.answers] == [False]
    assert exchange.requests == []


def test_the_log_gets_both_directions_in_order():
    records: list[Chunk | CanFrame] = []
    exchange = dialogue(log=records.append).ask(READ, 500 * MS)
    assert [r.direction for r in records] == [Role.REQUEST, Role.REPLY]
    assert [r.data for r in exchange.records()] == [READ, exchange.replies[0].data]
    times = [r.t_ns or 0 for r in exchange.records()]
    assert times == sorted(times)


def test_what_the_gate_refuses_begins_no_exchange():
    with pytest.raises(Refused):
        dialogue(allow=frozenset()).ask(MOVE, 100 * MS)


def test_what_went_over_the_line_is_shown_in_units():
    lines = dialogue().ask(build(MKS, "run_speed", 1, {"direction": 1, "speed": 320, "acceleration": 2}), 500 * MS).lines()
    assert lines[0].endswith("run_speed direction=cw speed=320 rpm acceleration=2")
    assert dialogue().ask(READ, 500 * MS).lines()[1].endswith("read_speed speed=0 rpm")


class CanLine(Line):
    """A CAN bus on which another node speaks before each reply."""

    def __init__(self, *pieces: bytes, drive: str) -> None:
        EmulatedLine.__init__(self, [make.make(make.parse(drive))])
        self.pieces = list(pieces)

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        got = super().receive(timeout_ns)
        return CanFrame(got.t_ns, "emulated", 0x701, got.data) if isinstance(got, Chunk) else got


def test_frames_of_other_nodes_are_no_answers():
    can = dialects.get("mks-can")
    talk = Dialogue(Gate(CanLine(b"\5", b"\x7f", drive="mks-can@1"), Allowance()), [can])
    exchange = talk.ask(CanFrame(None, "host", 1, build(can, "read_speed", 1)), 500 * MS)
    assert [message.who for message in exchange.foreign] == ["0x701", "0x701"]
    assert exchange.received == exchange.replies[0].data
    assert (exchange.others, exchange.findings, exchange.completion) == ([], [], Completion.DONE)


def test_who_is_asked_is_a_drive_whatever_it_answers():
    can = dialects.get("mks-can")
    talk = Dialogue(Gate(CanLine(b"\x9c\0\0", drive="mks-can@9"), Allowance()), [can])
    exchange = talk.ask(CanFrame(None, "host", 0x701, build(can, "read_speed", 0x701)), 50 * MS)
    assert exchange.foreign == []
    assert exchange.others[0].rules == ("bad_checksum", "unknown_command")


@pytest.mark.parametrize("flood", [b"\0", b"\xfb\x01\x32"])
def test_a_flood_costs_no_more_than_what_a_reply_can_stand_in(flood: bytes, monkeypatch: pytest.MonkeyPatch):
    looked_at = 0
    checks = type(MKS.link).checks

    def counted(link: Any, frame: bytes, can_id: int | None = None) -> Any:
        nonlocal looked_at
        looked_at += len(frame)
        return checks(link, frame, can_id)

    monkeypatch.setattr(type(MKS.link), "checks", counted)
    exchange = Exchange(READ, 0, MKS.by_name["read_speed"], 1, received=flood * 50_000)
    found = reply_match.replies(exchange, MKS)
    assert sum(len(r.data) for r in found.readings) + sum(map(len, found.leftover)) == len(exchange.received)
    assert looked_at < 2_000_000


@pytest.mark.parametrize("size", [1, 4, 5])
def test_a_wait_goes_on_to_the_end_of_a_frame_that_has_begun(size: int):
    """A reply that pauses across the time-out is read whole, and belongs to this exchange."""
    reply = build(MKS, "read_speed", 1, {}, Role.REPLY)
    talk = dialogue(reply[:size], reply[size:], drive="mks-rs485@7")
    exchange = talk.ask(READ, 3 * MS // 2)
    assert [a.data for a in exchange.replies] == [reply]
    assert exchange.junk == []
    assert talk.listen(50 * MS).received == b""


def test_a_wait_for_the_end_of_a_frame_ends():
    """Endless bytes without a frame are listened to for as long as the longest frame takes."""
    exchange = dialogue(*[b"\xfb"] * 2000, drive="mks-rs485@7").ask(READ, 10 * MS)
    assert exchange.replies == []
    assert took_ms(exchange) < 80


@pytest.mark.parametrize("stray", [b"\xff", b"\x00"])
@pytest.mark.parametrize("pulses", [0xFFFBFFFB, 0xFFFFFB00, 0xFFFFFFFF, 0x00FB00FB, 0])
def test_a_byte_that_the_line_shows_before_a_reply_is_no_byte_of_one(stray: bytes, pulses: int):
    """Wherever a reply pauses: what its second part begins with is its own, even if it looks like the begin of a reply."""
    signed = pulses - (1 << 32 if pulses >> 31 else 0)
    reply = build(MKS, "read_pulses", 1, {"pulses": signed}, Role.REPLY)
    for pause in range(1, len(reply)):
        pieces = (stray + reply[:pause], reply[pause:], stray + reply)
        line = Line(*pieces, drive="mks-rs485@7")
        talk = Dialogue(Gate(line, Allowance(frozenset(Risk))), [MKS], stray=stray, bare=BareReplies(MKS))
        exchange = talk.ask(build(MKS, "read_pulses", 1), 50 * MS, until=Until.TIMEOUT)
        assert [a.data for a in exchange.answers] == [reply, reply], pause
        assert exchange.received == reply * 2


@pytest.mark.parametrize("on_ms", [0, 60])
def test_a_wait_ends_behind_bytes_that_were_the_reply_and_goes_on_where_one_may_still_come(on_ms: int):
    wrecked = b"\xf3" + OTHER_REPLY[1:]
    talk = dialogue(wrecked, drive="mks-rs485@7")
    exchange = talk.collect(talk.send(READ), PAIRED[Until.REPLY], 500 * MS, wrecked=lambda found: on_ms * MS)
    assert exchange.unread == len(wrecked)
    assert exchange.damaged
    # Behind the pause in which no more of it comes.
    assert took_ms(exchange) == (pytest.approx(on_ms + 15, abs=5) if on_ms else 500)


@pytest.mark.parametrize("drive", ["mks-rs485@1", "mks-modbus@1", "lk-rs485@1"])
def test_a_reply_that_the_line_damages_is_not_waited_for(drive: str):
    for seed in range(12):
        rig = EmulatedRig(make.parse(f"{drive},line-errors=100%"), seed=seed)
        probe = rig.probe(next(c for c in registry.every(rig.dialect) if not c.risks - {Risk.READ}))
        exchange = probe.ask(Verb.READ_SPEED if drive.startswith("mks") else Verb.READ_POSITION)
        assert exchange.damaged
        assert not exchange.is_read
        assert took_ms(exchange) < 250 < rig.late_ns / MS


def test_a_command_that_tells_its_end_is_waited_for_behind_a_damaged_begin():
    rig = EmulatedRig(make.parse("mks-rs485@1,work_mode=sr_vfoc"))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if Risk.MOTION in c.risks))
    receive, seen = probe.gate.receive, []

    def damaged(timeout_ns: int) -> Chunk | CanFrame | None:
        got = receive(timeout_ns)
        if got is not None:
            seen.append(got)
        return msgspec.structs.replace(got, data=b"\xf3" + got.data[1:]) if got is not None and len(seen) == 1 else got

    probe.gate.receive = damaged
    exchange = probe.ask("move_relative_axis", {"speed": 600, "acceleration": 250, "position": 16384}, until=Until.DONE)
    assert [a.values["status"] for a in exchange.answers if a.is_whole] == [2]
    assert exchange.unread == len(seen[0].data)
