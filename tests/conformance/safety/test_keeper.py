"""Settings of a real rig, on emulated drives in virtual time: read, stored in the journal, restored after any failure."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import msgspec
import pytest

from analyzer.catalogue import Risk
from analyzer.cli import main
from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import LineLost
from conformance.claim import Claim, Outcome, RigFault, Theme
from conformance.drives import make
from conformance.gate.budget import Budget
from conformance.gate.permissions import Allowance, parse_allow
from conformance.safety import journal
from conformance.safety.keeper import command_of, restore
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.rig_real import RealRig
from conformance.suite.target import parse

PLACES = {"serial": "serial:/dev/nowhere,baud=38400", "can": "can:virtual:nowhere"}
EVERYTHING = parse_allow("setting,motion,torque,unbounded,link,wear,power-on")


class EmulatedPort(RealRig):
    """The rig of a real drive, whose port leads to emulated ones."""

    def __init__(self, drive, tmp_path, *, allowance=None, settings=None, beside=(), claims=()):
        self.drives = [make.make(make.parse(text)) for text in (drive, *beside)]
        bus = self.drives[0].dialect.bus
        target = parse(drive.partition(",")[0], PLACES[bus])
        allowance = allowance or Allowance(EVERYTHING)
        plan = suite.Plan((target,), allowance, tuple(claims), settings={"": settings or {}}, journal=str(tmp_path / "j"))
        super().__init__(plan, target)

    def _open_line(self):
        self.line = EmulatedLine(self.drives)
        self.line.emulated = False
        return self.line

    def _open_gate(self):
        gate = super()._open_gate()
        self.left = getattr(self, "left", [])
        gate.on_sent.append(lambda t_ns, item: self.left.append((t_ns, item)))
        return gate

    def setting(self, name):
        return self.drives[0].settings[name]


def claim(rig, check, *risks, alone=False):
    name = f"{rig.dialect.name}/state/x"
    return Claim(name, Theme.STATE, rig.dialect.name, "x", "", "x", check, risks=frozenset(risks), alone=alone)


def ran(rig, check, *risks, **more):
    return engine.run_claim(claim(rig, check, *risks, **more), rig)


def test_what_is_read_first_is_put_back_and_the_journal_goes(tmp_path):
    rig = EmulatedPort("mks-can@1,current=1200", tmp_path)
    verdict = ran(rig, lambda p: p.do("set_current", {"current": 900}) and None, Risk.SETTING)
    assert verdict.outcome is Outcome.CONFIRMED
    assert rig.setting("current") == 1200
    rig.close()
    assert not (tmp_path / "j").exists()


def test_before_the_change_leaves_the_journal_says_what_was(tmp_path):
    rig = EmulatedPort("mks-can@1,current=1200", tmp_path)
    seen = []

    def check(probe):
        written = (tmp_path / "j").read_bytes()
        rig.gate.on_sent.insert(0, lambda t_ns, item: seen.append((item.data[0], (tmp_path / "j").read_bytes())))
        assert written == b""
        probe.do("set_current", {"current": 900})

    ran(rig, check, Risk.SETTING)
    told = next(text for code, text in seen if code == 0x83)
    assert b'"values":{"current":1200}' in told
    rig.close()


@pytest.mark.parametrize("bound", [{"current": 1000.0}, {"budget": Budget(commands=1)}, {"speed": 10.0}])
def test_what_was_there_is_put_back_whatever_the_bounds_and_the_budget(bound, tmp_path):
    rig = EmulatedPort("mks-can@1,current=1200", tmp_path, allowance=replace(Allowance(EVERYTHING), **bound))
    verdict = ran(rig, lambda p: p.do("set_current", {"current": 900}) and None, Risk.SETTING)
    assert verdict.outcome is Outcome.CONFIRMED
    assert rig.setting("current") == 1200
    rig.close()


def test_each_parameter_of_an_lk_drive_is_put_back_and_told_apart_in_the_journal(tmp_path):
    rig = EmulatedPort("lk-rs485@1", tmp_path)
    before = {n: _lk(rig, n) for n in (10, 32)}

    def check(probe):
        for number, values in before.items():
            names = [n for n in values if n != "parameter"]
            probe.do("write_parameter", {"parameter": number, **dict.fromkeys(names, 123)})
            assert _lk(rig, number) != values
        text = (tmp_path / "j").read_bytes()
        changes = journal.open_changes(journal.read(tmp_path / "j"))
        assert len(changes) == 2, text
        assert [command_of(change).name for change in changes] == ["write_parameter"] * 2

    verdict = ran(rig, check, Risk.SETTING)
    assert verdict.outcome is Outcome.CONFIRMED, verdict.reason
    assert {n: _lk(rig, n) for n in before} == before
    assert journal.open_changes(journal.read(tmp_path / "j")) == []
    rig.close()


def _lk(rig, number):
    from conformance.talk.probe import plain_probe

    probe = plain_probe(rig.dialect, rig.address, rig.gate)
    exchange = probe.ask("read_parameter", {"parameter": number})
    return dict(probe.reply(exchange).values)


def test_a_setting_that_nobody_tells_is_not_changed(tmp_path):
    rig = EmulatedPort("mks-rs485@1,current=1200", tmp_path)
    verdict = ran(rig, lambda p: p.do("set_current", {"current": 900}) and None, Risk.SETTING)
    assert verdict.outcome is Outcome.NOT_RUN
    assert "--settings" in verdict.reason
    assert rig.setting("current") == 1200
    rig.close()


@pytest.mark.parametrize(
    ("told", "outcome", "left"), [({}, Outcome.NOT_RUN, 0), ({"group_address": "80"}, Outcome.CONFIRMED, 80)]
)
def test_a_drive_in_no_group_is_left_where_the_user_says(told, outcome, left, tmp_path):
    rig = EmulatedPort("mks-can@1", tmp_path, allowance=Allowance(EVERYTHING, alone=True), settings=told)
    verdict = ran(rig, lambda p: p.do("set_group_address", {"group_address": 99}) and None, Risk.SETTING, Risk.LINK, alone=True)
    rig.close()
    assert (verdict.outcome, rig.setting("group_address")) == (outcome, left)


def test_what_is_sent_to_all_drives_is_put_back_too(tmp_path):
    rig = EmulatedPort("mks-can@1,current=1200", tmp_path, allowance=Allowance(EVERYTHING, alone=True))
    changed = []

    def check(probe):
        probe.send(probe.build("set_current", {"current": 900}, address=0).item())
        changed.append(rig.setting("current"))

    ran(rig, check, Risk.SETTING, alone=True)
    assert changed == [900]
    assert rig.setting("current") == 1200
    rig.close()


@pytest.mark.parametrize(
    ("drive", "command", "values", "where"),
    [
        ("mks-can@1", "set_address", {"new_address": 9}, "address"),
        ("mks-rs485@1", "set_address", {"new_address": 9}, "address"),
        ("mks-rs485@1", "set_baud_rate", {"baud_rate": 2}, "speed"),
        ("mks-can@1", "set_bit_rate", {"bit_rate": 1}, "speed"),
        ("mks-rs485@1", "set_modbus", {"modbus": 1}, "dialect"),
    ],
)
def test_a_changed_link_is_followed_and_put_back(drive, command, values, where, tmp_path):
    rig = EmulatedPort(drive, tmp_path, allowance=Allowance(EVERYTHING, alone=True))
    own = rig.drives[0]
    station = rig.line.bus.stations[0]
    before = (own.address, station.speed, rig.line.endpoint.bits_per_second)

    def check(probe):
        probe.ask(command, values)
        raise RuntimeError("the claim breaks off")

    verdict = ran(rig, check, Risk.SETTING, Risk.LINK, alone=True)
    assert "fault of the claim" in verdict.reason
    assert (own.address, station.speed, rig.line.endpoint.bits_per_second) == before
    assert ran(rig, lambda p: p.read("read_speed") and None).outcome is Outcome.CONFIRMED
    rig.close()
    assert not (tmp_path / "j").exists()


def test_a_journal_says_enough_to_lead_a_drive_back_after_a_crash(tmp_path):
    rig = EmulatedPort("mks-rs485@1", tmp_path, allowance=Allowance(EVERYTHING, alone=True))
    probe = rig.probe(claim(rig, lambda p: None))
    probe.ask("set_address", {"new_address": 9})
    probe.wait(1_000_000_000)
    assert rig.drives[0].address == 9
    # The suite has died here: only the journal is left.
    assert restore(tmp_path / "j", rig.gate.under(Allowance())) == ""
    assert rig.drives[0].address == 1
    assert journal.open_changes(journal.read(tmp_path / "j")) == []


_CHANGE = {"event": "change", "target": "mks-can@1", "on": "can:x:1", "command": "set_current", "address": 1,
           "values": {"current": 1200}, "sent": [{"current": 900}]}  # fmt: skip


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"event": "chbnge"}, "Invalid enum value 'chbnge'"),
        ({"sett": []}, "unknown field `sett`"),
        ({"on": "can:x:2"}, "expected the lines of one port, got can:x:1, can:x:2"),
        ({"on": "serial:x"}, "expected the lines of one port"),
    ],
)
def test_a_journal_that_no_run_can_have_written_is_refused_as_a_whole(more, expected, tmp_path, capsys):
    path = tmp_path / "j"
    path.write_bytes(b"".join(msgspec.json.encode(each) + b"\n" for each in (_CHANGE, _CHANGE | more)))
    before = path.read_bytes()
    assert main(["restore", str(path), "--dry-run"]) == 2
    told = capsys.readouterr()
    assert expected in told.err
    assert told.out == ""
    assert path.read_bytes() == before


def test_a_drive_of_another_kind_of_bus_is_no_drive_that_is_not_stopped(tmp_path, capsys):
    path = tmp_path / "j"
    path.write_bytes(msgspec.json.encode(_CHANGE))
    assert main(["restore", str(path), "--on", "serial:none", "--cut-power", "false"]) == 2
    assert "mks-can is a dialect of can, and serial:none is a serial bus" in capsys.readouterr().err


def test_the_end_of_one_drive_leaves_the_changes_of_another_open():
    one, other = (msgspec.convert(_CHANGE | {"target": name}, journal.Entry) for name in ("mks-can@1", "mks-can@2"))
    for target, left in (("mks-can@1", ["mks-can@2"]), ("", [])):
        entries = [one, other, journal.Entry(event="end", target=target)]
        assert [entry.target for entry in journal.open_changes(entries)] == left


def test_a_journal_that_is_gone_on_with_keeps_each_line_that_was_read(tmp_path):
    entry = journal.Entry(event="change", target="mks-can@1", command="set_current", address=1, values={"current": 1200})
    lines = b"".join(msgspec.json.encode(msgspec.structs.replace(entry, values={"current": n})) + b"\n" for n in (1200, 1300))
    path = tmp_path / "cut"
    for end in range(len(lines) + 1):
        path.write_bytes(lines[:end])
        read = journal.read(path)
        again = journal.Journal(path, again=True)
        assert journal.read(path) == read, end
        again.write(entry)
        again.close(remove=False)
        assert journal.read(path)[:-1] == read, end


def test_a_drive_is_not_set_to_a_speed_that_this_end_cannot_follow(tmp_path, monkeypatch):
    from analyzer.errors import UsageError

    rig = EmulatedPort("mks-can@1", tmp_path, allowance=Allowance(EVERYTHING, alone=True))

    def fixed(bits_per_second):
        raise UsageError("its bit rate cannot be set from here")

    monkeypatch.setattr(rig.line, "set_speed", fixed)
    verdict = ran(rig, lambda p: p.ask("set_bit_rate", {"bit_rate": 1}) and None, Risk.SETTING, Risk.LINK, alone=True)
    assert verdict.outcome is Outcome.NOT_RUN
    assert "cannot follow" in verdict.reason
    assert rig.line.bus.stations[0].speed == rig.line.endpoint.bits_per_second
    rig.close()


def test_a_speed_kept_for_the_next_power_on_is_forgotten_again(tmp_path):
    rig = EmulatedPort("mks-rs485@1,work_mode=sr_vfoc", tmp_path, settings={"work_mode": "sr_vfoc"})

    def check(probe):
        probe.do("enable", {"enabled": 1})
        probe.do("run_speed", {"direction": 0, "speed": 30, "acceleration": 200})
        probe.ask("save_speed", {"save_state": 0xC8})

    ran(rig, check, Risk.SETTING, Risk.MOTION, Risk.UNBOUNDED, Risk.WEAR, Risk.POWER_ON)
    sent = [item.hex(" ").upper() for _, item in rig.left]
    assert "FA 01 FF C8 C2" in sent
    assert sent.index("FA 01 FF CA C4") > sent.index("FA 01 FF C8 C2")
    rig.close()


def test_writes_keep_their_distance_also_where_things_are_put_back(tmp_path):
    rig = EmulatedPort("mks-can@1,current=1200", tmp_path)
    for _ in range(2):
        ran(rig, lambda p: p.do("set_current", {"current": 900}) and None, Risk.SETTING)
    times = [t for t, item in rig.left if item.data[0] == 0x83]
    assert len(times) == 4
    assert min(b - a for a, b in pairwise(times)) >= 500_000_000
    rig.close()


def test_a_lost_port_keeps_the_journal_and_is_told(tmp_path, capsys):
    rig = EmulatedPort("mks-can@1,current=1200", tmp_path)

    def check(probe):
        probe.do("set_current", {"current": 900})
        rig.line.close()
        probe.read("read_speed")

    with pytest.raises(LineLost):
        ran(rig, check, Risk.SETTING)
    with pytest.raises(RigFault, match="not put back"):
        rig.close()
    assert "servotap restore" in capsys.readouterr().err
    assert [c.values for c in journal.open_changes(journal.read(tmp_path / "j"))] == [{"current": 1200}]


def test_without_alone_no_byte_goes_to_another_address(tmp_path):
    """Every claim that runs without --alone, on a bus with a neighbour that must not be spoken to."""
    rig = EmulatedPort("mks-can@1", tmp_path, beside=("mks-can@2",), allowance=Allowance(EVERYTHING))
    few = [c for c in suite.every_claim(rig._target) if c.theme in (Theme.EXAMPLES, Theme.ADDRESSING, Theme.FRAMING)]
    outcomes = [engine.run_claim(c, rig).outcome for c in few]
    rig.close()
    assert outcomes.count(Outcome.CONFIRMED) > 20
    assert Outcome.REFUTED not in outcomes
    assert {item.id for _, item in rig.left} == {1}


def test_alone_is_refused_where_another_drive_answers(tmp_path):
    with pytest.raises(RigFault, match="mks-can@2 answers too"):
        EmulatedPort("mks-can@1", tmp_path, beside=("mks-can@2",), allowance=Allowance(EVERYTHING, alone=True))
    assert not (tmp_path / "j").exists()


def test_a_brake_is_put_back_as_a_setting_is_and_reading_it_changes_nothing(tmp_path):
    rig = EmulatedPort("lk-rs485@1,model=MF", tmp_path)

    def brakes(control):
        left = len(rig.left)
        ran(rig, lambda p: p.ask("brake", {"brake_control": control}) and None, Risk.TORQUE)
        return [item[-2] for _, item in rig.left[left:] if item[1] == 0x8C]

    assert brakes(0x10) == [0x10]
    # What it was is read; without power, as asked; released again, and looked at.
    assert brakes(0x00) == [0x10, 0x00, 0x01, 0x10]
    rig.close()


def test_a_position_whose_bytes_begin_another_frame_is_put_back_beside_it(tmp_path):
    rig = EmulatedPort("lk-rs485@1", tmp_path)
    # FA C4 00 00 BE, its end and the sum of it all, is a native frame to another drive.
    rig.drives[0].motor.set_position(0xC4FA / 100)
    verdict = ran(rig, lambda p: p.do("set_position", {"position": 0}) and None, Risk.SETTING)
    assert verdict.outcome is Outcome.CONFIRMED, verdict.reason
    assert round(rig.drives[0].motor.position * 100) == 0xC4FA - 3
    rig.close()


def test_each_line_that_a_run_writes_is_taken_back(tmp_path):
    allowance = Allowance(frozenset(Risk), alone=True)
    rig = EmulatedPort("mks-can@1", tmp_path, allowance=allowance, settings={"group_address": "80"})

    def check(probe):
        probe.ask("restore")
        changes = journal.open_changes(journal.read(tmp_path / "j"))
        assert len([command_of(change) for change in changes]) > 10

    verdict = ran(rig, check, *Risk, alone=True)
    assert verdict.outcome is Outcome.CONFIRMED, verdict.reason
    rig.close()


LINE = {"event": "change", "target": "mks-rs485@1", "command": "set_current", "address": 1, "values": {"current": 1600}}


@pytest.mark.parametrize(
    "wrong",
    [
        {"command": "nope"},
        {"command": "run_speed", "values": {"direction": 0, "speed": 320, "acceleration": 2}},
        {"command": "restart", "values": {}},
        {"command": "set_zero", "values": {}},
        {"target": "mks-rs485@1,model=ZZ"},
        {"target": "nobody@1"},
        {"address": 999},
        {"values": {}},
        {"values": {"current": 1600, "x": 1}},
        {"sent": [{"x": 1}]},
    ],
)
def test_a_line_that_no_run_can_have_written_is_refused(wrong, tmp_path, capsys):
    path = tmp_path / "j"
    path.write_text(json.dumps(LINE | wrong) + "\n")
    assert main(["restore", str(path), "--dry-run"]) == 2
    assert "not a line of a run" in capsys.readouterr().err


def test_all_is_put_back_where_the_journal_takes_no_more(tmp_path, monkeypatch, capsys):
    rig = EmulatedPort("mks-can@1", tmp_path)
    before = dict(rig.drives[0].settings)

    def check(probe):
        probe.ask("set_current", {"current": 800})
        probe.ask("set_subdivision", {"subdivision": 8})

        def full(file, entry):
            raise RigFault("no room")

        monkeypatch.setattr(journal.Journal, "write", full)

    assert ran(rig, check, Risk.SETTING).outcome is Outcome.CONFIRMED
    rig.close()
    assert dict(rig.drives[0].settings) == before
    assert capsys.readouterr().err.count("it will not say what was put back") == 1
