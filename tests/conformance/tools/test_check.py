"""`servotap check`: recordings judged by the claims that need nothing but traffic; and those claims in a run of the suite."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.findings import RULES
from analyzer.records import CanFrame, Chunk, Finding, Severity
from conformance.claim import Outcome, Theme
from conformance.claims.frames import traffic as theme
from conformance.claims.frames.traffic_rules import ROWS, Party, row_of
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.theme_runs import claims_of, run

READS = ("read_position", "read_speed", "read_status", "read_enabled", "read_encoder_carry", "read_io")


def finding(rule, topic="/bus/1/read_speed/reply"):
    return Finding(rule, Severity.ERROR, "bus", 1, 0, 0, "text", topic=topic)


# --- the table --------------------------------------------------------------------------------------------------------


def test_every_rule_of_the_analyzer_is_a_claim():
    assert {row.rule for row in ROWS} == set(RULES)
    assert len({row.name for row in ROWS}) == len(ROWS)


def test_who_sent_a_frame_is_to_blame_for_it():
    assert row_of(finding("bad_checksum")).about is Party.DRIVE
    assert row_of(finding("bad_checksum", "/bus/1/read_speed/request")).about is Party.HOST
    assert row_of(finding("bad_checksum", "/bus/unknown")).about is Party.HOST
    assert row_of(finding("junk_noise", "/bus/junk")).about is Party.WIRE
    assert row_of(finding("a_rule_of_tomorrow")).about is Party.WIRE


# --- in a run of the suite --------------------------------------------------------------------------------------------


def test_a_session_is_shared():
    rig = EmulatedRig(make.parse("mks-can@1"))
    one, other = claims_of(Theme.TRAFFIC, rig)[:2]
    probes = [rig.probe(c) for c in (one, other)]
    for probe in probes:
        probe.claim.check(probe)
    assert probes[0].raw
    assert all(mine is shared for mine, shared in zip(*(p.raw for p in probes), strict=True))


# A status of 3B beyond its choices with a wrong sum, and with the right one.
@pytest.mark.parametrize(("frame", "found"), [("FB 01 3B 81 B9", {"reply_checks"}), ("FB 01 3B 81 B8", {"reply_choices"})])
def test_what_a_damaged_reply_holds_is_not_judged(frame, found):
    items = [Chunk(0, "", bytes.fromhex("FA 01 3B 36"), Role.REQUEST), Chunk(5_000_000, "", bytes.fromhex(frame), Role.REPLY)]
    judge = theme.judged(items, dialects.get("mks-rs485"))
    of_drive = [c.row.name for c in judge.counts() if c.found and c.row.about is Party.DRIVE]
    assert set(of_drive) - {"answered"} == found


def test_a_quirk_that_makes_replies_unreadable_is_named():
    verdicts = run(Theme.TRAFFIC, "mks-rs485@1,quirk=no-checksum").values()
    assert {(v.outcome, v.quirks) for v in verdicts} == {(Outcome.REFUTED, ("no-checksum",))}


# --- recordings -------------------------------------------------------------------------------------------------------


def recording(path, drive, commands=READS):
    """Write a capture of an emulated drive that is asked some reads; return its path."""
    rig = EmulatedRig(make.parse(drive))
    probe = rig.probe(claims_of(Theme.TRAFFIC, rig)[0])
    for name in commands:
        if name in rig.dialect.by_name:
            probe.ask(name)
    begin = datetime(2026, 3, 2, 9, tzinfo=UTC)
    lines = []
    for item in probe.raw:
        at = (begin + timedelta(microseconds=item.t_ns / 1000)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        assert not isinstance(item, CanFrame)
        lines.append(f"{at} {'>' if item.direction == 'request' else '<'} {item.data.hex(' ').upper()}")
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def check(capsys, *words):
    status = main(["check", *words])
    return status, capsys.readouterr()


def test_a_recording_of_a_good_drive_is_confirmed(tmp_path, capsys):
    status, output = check(capsys, recording(tmp_path / "good.log", "mks-rs485@1"))
    assert status == 0
    assert "failed" not in output.out
    assert "6 requests, 6 replies" in output.out


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("checksum-wrong", "reply_checks"),
        ("doubled-reply", "once"),
        ("lost-reply", "answered"),
        ("reserved-bits-set", "reply_reserved"),
        ("status-outside-list", "reply_choices"),
        ("first-reply-only", "answered"),
    ],
)
def test_a_recording_of_a_faulty_drive_is_refuted_by_the_claim_about_it(tmp_path, capsys, fault, name):
    path = recording(tmp_path / "bad.log", f"mks-rs485@1,fault={fault}")
    status, output = check(capsys, path, "--json", "--about", "drive", "--dialect", "mks-rs485")
    document = json.loads(output.out)
    wrong = {c["id"]: c for c in document["claims"] if c["outcome"] == "refuted"}
    assert status == 1
    assert f"mks-rs485/traffic/{name}" in wrong
    found = wrong[f"mks-rs485/traffic/{name}"]
    assert found["findings"] >= 1
    assert found["addresses"] == {"1": found["findings"]}
    assert len(found["examples"]) <= 3
    assert document["refuted"] == len(wrong)


def test_each_example_shows_when_who_and_the_bytes(tmp_path, capsys):
    path = recording(tmp_path / "bad.log", "mks-rs485@1,fault=checksum-wrong", READS[:2])
    status, output = check(capsys, path, "--examples", "1")
    assert status == 1
    assert output.out.count("checksum: expected") == 1
    assert "address 1, checksum: expected 2D, got 87  FB 01 31" in output.out
    assert "by address  1: 2" in output.out


def test_the_host_is_told_apart_from_the_drive(tmp_path, capsys):
    path = tmp_path / "host.log"
    path.write_text("2026-03-02T09:00:00.0Z > FA 01 83 17 70 05\n2026-03-02T09:00:00.01Z < FB 01 83 00 7F\n")
    status, output = check(capsys, str(path), "--about", "host")
    assert status == 1
    assert "mks-rs485/traffic/host/request_ranges" in output.out
    status, output = check(capsys, str(path), "--about", "drive")
    assert status == 0
    assert "observed" in output.out  # the drive refused, as the manual has it


def test_a_reply_beyond_the_limit_is_late(tmp_path, capsys):
    path = tmp_path / "late.log"
    path.write_text("2026-03-02T09:00:00.0Z > FA 01 3A 35\n2026-03-02T09:00:00.6Z < FB 01 3A 01 37\n")
    assert check(capsys, str(path))[0] == 0
    status, output = check(capsys, str(path), "--late", "500")
    assert status == 1
    assert "mks-rs485/traffic/in_time" in output.out


def test_what_was_not_seen_did_not_run(tmp_path, capsys):
    path = recording(tmp_path / "good.log", "mks-rs485@1")
    _, output = check(capsys, path, "--all")
    assert "not run            mks-rs485/traffic/broadcast" in output.out
    assert "no broadcasts in the recording" in output.out


def test_captures_of_other_formats_and_buses(capsys):
    for name in ("mks_can.blf", "lk_rs485.log", "mks_rs485.mcap", "mks_modbus.poll.txt"):
        status, output = check(capsys, f"captures/{name}")
        assert status in (0, 1), output.err
        assert "Traceback" not in output.err
        assert "passed" in output.out


def test_where_no_frame_is_there_nothing_is_confirmed(capsys):
    status, output = check(capsys, "captures/mks_rs485.log", "--since", "+10h")
    assert status == 2
    assert "no frames" in output.out
    assert "mks_rs485.log: no frame of a drive is there to judge" in output.err


def test_several_files_one_of_which_cannot_be_read(tmp_path, capsys):
    good = recording(tmp_path / "good.log", "mks-rs485@1")
    status, output = check(capsys, good, str(tmp_path / "none.log"))
    assert status == 2
    assert "none.log" in output.err
    assert "good.log" in output.out


def test_wrong_words_are_told_with_the_nearest(tmp_path, capsys):
    status, output = check(capsys, recording(tmp_path / "good.log", "mks-rs485@1"), "--about", "drve")
    assert status == 2
    assert "did you mean drive" in output.err


def test_claims_about_hosts_and_wires_do_not_run_on_a_drive():
    dialect = dialects.get("mks-can")
    assert {c.parameters["about"] for c in theme.claims(dialect)} == {"drive"}
