"""The suite on toy drives: no emulated drive speaks the dialect, and nothing of the project knows it."""

from __future__ import annotations

import json

import pytest

from analyzer.catalogue import Risk
from analyzer.cli import main
from conformance.claim import Outcome
from conformance.gate.permissions import Allowance
from conformance.suite import engine, target
from conformance.suite.plan import Plan, every_claim
from tests.toy.bus import VirtualRig, served
from tests.toy.drive import ToyDrive

SETTINGS = {"": {"current": "1000"}}


@pytest.fixture
def verdicts(toy, tmp_path, monkeypatch):
    """Run claims on a toy drive in virtual time; return the outcomes and the reasons by what follows the dialect's name."""
    monkeypatch.chdir(tmp_path)

    def run(drive, *wanted, **bounds):
        asked = target.parse("toy-can@2", "can:virtual:toy")
        plan = Plan(
            (asked,), Allowance(frozenset(Risk), alone=True, spoken=frozenset({"toy-can"}), **bounds), settings=SETTINGS
        )
        rig = VirtualRig(drive, plan, asked)
        try:
            names = [(claim.id.partition("/")[2], claim) for claim in every_claim(asked)]
            return {n: engine.run_claim(c, rig) for n, c in names if not wanted or any(w in n for w in wanted)}
        finally:
            rig.close()

    return run


def _of(verdicts, outcome):
    return {name for name, verdict in verdicts.items() if verdict.outcome is outcome}


def test_a_drive_as_its_manual_has_it_confirms_all_that_can_be_asked_of_it(verdicts):
    found = verdicts(ToyDrive())
    rest = {name: verdict.reason for name, verdict in found.items() if verdict.outcome is not Outcome.CONFIRMED}
    emulated = {n for n, reason in rest.items() if "only an emulated one" in reason}
    # A read of the toy has no data that could be cut off.
    bare = {f"framing/{kind}/{name}" for kind in ("truncated", "underlong") for name in ("ignored", "next")}
    # Nothing tells whether the motor is on, so what must not switch it on is not seen.
    unseen = {"addressing/other/motor_on", "framing/motor_on/guarded", "framing/motor_on/other-length"}
    by_name = {"resilience/idle/first-long"}
    assert rest.keys() == emulated | bare | unseen | by_name, sorted(
        (n, r) for n, r in rest.items() if n not in emulated | bare
    )
    themes = {name.partition("/")[0] for name in _of(found, Outcome.CONFIRMED)}
    assert themes == {"shape", "framing", "examples", "addressing", "traffic", "ranges", "timing", "motion", "resilience"}
    moving = {name for name in found if name.startswith("motion/")}
    assert {"motion/move_to/reaches", "motion/run_speed/speed--500", "motion/stop/ends-a-move"} <= moving
    assert not any("unmade" in name for name in found)
    assert not any("check" in name for name in found), "a frame without a check has none that could be wrong"


def test_a_current_out_of_range_that_is_accepted_is_refuted(verdicts):
    found = verdicts(ToyDrive(highest_current=9000), "ranges/", "shape/set_current")
    assert _of(found, Outcome.REFUTED) == {"ranges/set_current/current/above"}
    assert "current 4001 is accepted" in found["ranges/set_current/current/above"].reason


def test_half_the_speed_is_refuted_by_what_runs_and_moves(verdicts):
    found = verdicts(ToyDrive(speed_factor=0.5), "motion/")
    assert {f"motion/run_speed/speed-{n}" for n in (10, -180, 360, -500)} <= _of(found, Outcome.REFUTED)
    assert "motion/move_to/max-speed" in _of(found, Outcome.REFUTED)
    assert "motion/move_to/reaches" in _of(found, Outcome.CONFIRMED), "it gets there all the same"


def test_within_bounds_nothing_is_sent_that_is_beyond_them(verdicts):
    found = verdicts(ToyDrive(), "motion/", "ranges/run", speed=40, turns=0.5)
    refused = {name: v.reason for name, v in found.items() if v.outcome is Outcome.NOT_RUN}
    assert "above --max-speed 40" in refused["motion/run_speed/speed-360"]
    assert "above --max-speed 40" in refused["ranges/run/speed/highest"]
    assert found["motion/run_speed/speed--180"].outcome is Outcome.CONFIRMED
    assert not _of(found, Outcome.REFUTED)


# --- on a real port ---------------------------------------------------------------------------------------------------


@pytest.fixture
def on_port(toy, tmp_path, monkeypatch, capsys):
    """Run `servotap test` on a toy drive behind an adapter; return the exit status, the outcomes and what was said."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "known.json").write_text(json.dumps(SETTINGS[""]))

    def run(drive, *words):
        with served(drive) as place:
            status = main(["test", "toy-can@2", "--on", place, "--settings", "known.json", "--json", *words])
        said = capsys.readouterr()
        records = [json.loads(line) for line in said.out.splitlines() if line.startswith("{")]
        return status, {r["id"].partition("/")[2]: r["outcome"] for r in records if "id" in r}, said.err

    return run


FEW = [
    word
    for name in ("shape/read_speed/*", "ranges/set_current/*/above", "motion/stop/stops")
    for word in ("--claim", f"*/{name}")
]


def test_it_is_tested_on_a_real_port(on_port):
    status, outcomes, err = on_port(ToyDrive(), "--allow", "setting,motion,unbounded,torque", *FEW)
    assert (status, set(outcomes.values())) == (0, {"confirmed"}), (outcomes, err)
    assert {"shape/read_speed/address", "ranges/set_current/current/above", "motion/stop/stops"} <= outcomes.keys()


def test_reads_alone_are_sent_where_nothing_is_allowed(on_port):
    drive = ToyDrive(highest_current=9000)
    status, outcomes, _ = on_port(drive, *FEW)
    assert (status, outcomes["ranges/set_current/current/above"], outcomes["motion/stop/stops"]) == (0, "not run", "not run")
    assert (drive.on, drive.current) == (False, 1000)


def test_a_wrong_drive_is_refuted_on_a_real_port(on_port):
    status, outcomes, _ = on_port(
        ToyDrive(highest_current=9000), "--allow", "setting,torque", "--claim", "*/set_current/*/above"
    )
    assert (status, outcomes["ranges/set_current/current/above"]) == (1, "refuted")


def test_a_node_that_is_not_there_is_not_taken_for_another(on_port):
    status, _, err = on_port(ToyDrive(node=5), *FEW)
    assert status == 10
    assert "toy-can@2 does not answer" in err
    assert "toy-can@5 does: it has another address" in err


def test_every_node_is_found_by_a_scan(toy, capsys):
    with served(ToyDrive(node=0)) as place:
        assert main(["scan", place, "--dialects", "toy-can", "--addresses", "0-2", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["found"]
    assert (found["dialect"], found["address"]) == ("toy-can", 0)


def test_a_dry_run_says_that_no_emulated_drive_stands_in(on_port):
    status, _, err = on_port(ToyDrive(), "--dry-run", *FEW)
    assert status == 2
    assert "no emulated drive speaks toy-can" in err
