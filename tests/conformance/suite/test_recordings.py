"""A motion that several claims judge is recorded once, and anew where a refutation is confirmed."""

from __future__ import annotations

import pytest

from analyzer.cli import main
from conformance.claim import Claim, Inconclusive, Outcome, Refuted, Theme
from conformance.drives import make
from conformance.suite import engine, plan
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.target import every_emulated
from tests.conformance.safety.test_keeper import EmulatedPort


def only(check, **facts):
    return Claim("mks-rs485/state/x", Theme.STATE, "mks-rs485", "x", "", "x", check, **facts)


def recorder(made):
    def record(probe, name):
        made.append(name)
        return probe.ask("read_speed")

    return record


def judging(record, name="speed", refuted=False):
    def check(probe):
        exchange = probe.recorded(record, name)
        if refuted:
            raise Refuted("it is slow", exchange=exchange)

    return only(check)


def test_claims_of_one_recording_share_it_and_show_its_bytes(tmp_path):
    made = []
    record = recorder(made)
    rig = EmulatedPort("mks-rs485@1", tmp_path)
    first, second = (engine.run_claim(judging(record), rig) for _ in range(2))
    rig.close()
    assert made == ["speed"]
    assert first.traffic == second.traffic != ()
    assert (first.first_ns, first.last_ns) == (second.first_ns, second.last_ns)


def test_what_was_done_tells_recordings_apart(tmp_path):
    made = []
    record = recorder(made)
    rig = EmulatedPort("mks-rs485@1", tmp_path)
    for name in ("speed", "place", "speed"):
        engine.run_claim(judging(record, name), rig)
    rig.close()
    assert made == ["speed", "place"]


def test_a_refutation_is_confirmed_by_a_recording_of_its_own(tmp_path):
    made = []
    rig = EmulatedPort("mks-rs485@1", tmp_path)
    verdict = engine.run_claim(judging(recorder(made), refuted=True), rig)
    rig.close()
    assert made == ["speed", "speed"]
    assert "2 of 2 times" in verdict.reason


def test_what_did_not_work_is_tried_again_by_the_next_claim(tmp_path):
    tries = []

    def record(probe):
        tries.append(probe.read("read_speed"))
        if len(tries) == 1:
            raise Inconclusive("it was not answered")

    rig = EmulatedPort("mks-rs485@1", tmp_path)
    verdicts = [engine.run_claim(only(lambda probe: probe.recorded(record)), rig) for _ in range(2)]
    rig.close()
    assert [v.outcome for v in verdicts] == [Outcome.INCONCLUSIVE, Outcome.CONFIRMED]
    assert verdicts[0].traffic


@pytest.mark.parametrize("backwards", [False, True])
def test_on_an_emulated_drive_a_recording_does_not_depend_on_which_claim_came_first(backwards):
    target = every_emulated()[0]
    claims = [c for c in plan.every_claim(target) if "/motion/stop_speed/" in c.id and c.id.endswith(("by-ramp", "replies"))]
    rig = EmulatedRig(make.parse(target.text))
    found = {c.id: engine.run_claim(c, rig) for c in (claims[::-1] if backwards else claims)}
    alone = {c.id: engine.run_claim(c, EmulatedRig(make.parse(target.text))) for c in claims}
    assert len(claims) == 2
    assert {i: v.outcome for i, v in found.items()} == dict.fromkeys(alone, Outcome.CONFIRMED)
    assert {i: v.traffic for i, v in found.items()} == {i: v.traffic for i, v in alone.items()}


@pytest.mark.parametrize(("hasty", "gap_ns"), [(True, 0), (False, 500_000_000)])
def test_settings_keep_a_distance_until_the_drive_has_shown_that_it_needs_none(tmp_path, hasty, gap_ns):
    rig = EmulatedPort("mks-rs485@1", tmp_path)
    engine.run_claim(only(lambda probe: probe.read("read_speed"), hasty=hasty), rig)
    rig.close()
    assert rig.write_gap_ns == gap_ns


def test_a_dry_run_lists_what_claims_share_once(capsys: pytest.CaptureFixture[str]):
    claims = ("--claim", "mks-can/motion/move_relative_axis/distance", "--claim", "mks-can/motion/move_relative_axis/opposite")
    words = ["test", "mks-can@1", "--dry-run", *claims]
    assert main(words) == 0
    listed = capsys.readouterr().out.splitlines()
    heads = [line for line in listed if line.startswith("mks-can/") and line.endswith(" frames")]
    frames = [line for line in listed if line.startswith("    001#")]
    assert listed[-1].endswith(f"{len(heads)} claims would send {len(frames)} frames; 0 would not run")
    assert sum(int(head.split()[-2]) for head in heads) == len(frames)
    at = listed.index("mks-can/motion/move_relative_axis/opposite: 0 frames")
    assert listed[at + 1] == "    and 13 frames of claims above, sent once for all of them"
