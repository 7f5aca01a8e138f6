"""How a run ends: what counts most, and that a drive whose replies cannot be read is refuted and not moved."""

from __future__ import annotations

import pytest
from mcap.writer import Writer

from analyzer.system.own_process import Ended
from benchmarks.gate import READS, sound
from conformance.claim import NotStopped, Outcome, RigFault, Verdict, worst
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.record import doubt_about, most_inconclusive
from tests.conformance.cli.test_stop import GoneReader
from tests.conformance.drives.served import on_logged_pty, on_pty
from tests.conformance.safety.test_keeper import EmulatedPort, claim
from tests.conformance.suite.test_suite import main

ALL = ("--allow", "setting,motion,torque,unbounded,unknown", "--subdivision", "16", "--max-speed", "300")


@pytest.mark.parametrize(
    ("statuses", "status"), [((0, 10), 10), ((1, 10), 1), ((10, 1, 20), 20), ((0, 0), 0), ((0, 2), 2), ((), 0)]
)
def test_not_stopped_counts_most_then_a_refutation_then_the_rig(statuses, status):
    assert worst(*statuses) == status


class Record:
    def __init__(self, outcome: str) -> None:
        self.outcome = outcome


@pytest.mark.parametrize(
    ("most", "inconclusive", "confirmed", "not_run", "told"),
    [
        ("10%", 1, 9, 0, ""),
        ("10%", 2, 9, 90, "2 of 11 claims"),
        ("3", 3, 1, 0, ""),
        ("3", 4, 100, 0, "4 of 104 claims"),
        ("100%", 5, 1, 0, ""),
        ("100%", 5, 0, 0, "no claim has a verdict"),
        ("10%", 0, 0, 413, "no claim has a verdict"),
    ],
)
def test_a_run_without_verdicts_or_with_many_inconclusive_ones_is_no_success(most, inconclusive, confirmed, not_run, told):
    records = [Record("inconclusive")] * inconclusive + [Record("confirmed")] * confirmed + [Record("not run")] * not_run
    assert doubt_about(records, most_inconclusive(most))[: len(told) or None] == told


@pytest.mark.parametrize("text", ["x", "-1", "101%", "0.5", ""])
def test_a_limit_that_is_none(text):
    with pytest.raises(ValueError):
        most_inconclusive(text)


def test_a_short_run_whose_time_was_over_says_so(capsys, monkeypatch):
    """A drive that answers half frames makes each claim wait for the rest."""
    whole = suite.run
    monkeypatch.setattr(suite, "run", lambda plan, jobs: (verdict for verdict in list(whole(plan, 1))[:2]))
    words = ["test", "mks-rs485@1", "--claim", "mks-rs485/shape/read_speed/*", "--jobs", "1"]
    for more, said in (["--short"], True), ([], False):
        assert main([*words, *more]) == 0
        told = capsys.readouterr().out.splitlines()[-1]
        assert told.startswith("2 of ")
        assert ("of them since the 90 s of a short run were over" in told) is said


def test_a_drive_whose_replies_cannot_be_read_is_refuted_and_not_moved(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with on_logged_pty("mks-rs485@1,work_mode=sr_vfoc,fault=checksum-wrong") as port:
        status = main(["test", "mks-rs485@1", "--on", port.on, *ALL, "--claim", "mks-rs485/motion/run_speed/*"])
        assert [str(seen) for seen in sound([port.heard]) if not seen.risks <= READS] == [], "reads alone have left"
    out, err = capsys.readouterr()
    assert status == 1, err
    assert "NOT STOPPED" not in err
    assert "FAILED  mks-rs485/shape/read_speed/checksum" in out
    assert "nothing that moves is sent" in out


def test_settings_that_are_not_taken_back_hide_no_refutation_and_are_tried_once(tmp_path, capsys, monkeypatch):
    from conformance.safety import keeper

    tried = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(keeper, "put_back", lambda probe, command, values: tried.append(command.name) or "refused")
    settings = tmp_path / "s.json"
    settings.write_text('{"work_mode": "sr_vfoc", "subdivision": 16, "current": 1600}')
    with on_pty("mks-rs485@1,model=57D,fault=current-one-more") as path:
        status = main(
            ["test", "mks-rs485@1,model=57D", "--on", f"serial:{path},baud=38400", "--allow", "setting,wear,torque",
             "--settings", str(settings), "--claim", "mks-rs485/ranges/set_current/*"]
        )  # fmt: skip
    out, err = capsys.readouterr()
    assert status == 1, out + err
    assert "set_current" in tried
    # In two work modes each: behind the claim that changed it first, and at the end of the run.
    assert tried.count("set_current") <= 4


def test_the_help_names_the_limit(capsys):
    with pytest.raises(SystemExit):
        main(["test", "--help"])
    assert "--max-inconclusive LIMIT" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("fault", "form", "status"), [("", (), 141), ("", ("--json",), 141), (",fault=checksum-wrong", (), 1)])
def test_a_reader_that_leaves_takes_neither_the_verdict_nor_the_log(fault, form, status, tmp_path, monkeypatch):
    log = tmp_path / "run.mcap"
    monkeypatch.setattr("sys.stdout", GoneReader())
    words = ("--claim", "*/shape/read_speed/checksum", "--jobs", "1", "--log", str(log))
    assert main(["test", f"mks-rs485@1{fault}", *words, *form]) == status
    assert log.stat().st_size > 500


WRONG_SUM = "mks-rs485@1,fault=checksum-wrong"


@pytest.fixture
def stored(tmp_path):
    """Return a stored failure."""
    assert main(["test", WRONG_SUM, "--claim", "*/shape/read_speed/checksum", "--failures", str(tmp_path)]) == 1
    (found,) = tmp_path.glob("*.mcap")
    return str(found)


@pytest.mark.parametrize(
    ("raised", "status"), [(RigFault("the port is gone"), 1), (NotStopped("NOT STOPPED"), 20)], ids=["rig", "not stopped"]
)
def test_what_a_rerun_refuted_is_not_lost_where_the_rig_fails(raised, status, stored, cli, monkeypatch):
    def close(rig):
        raise raised

    monkeypatch.setattr("conformance.suite.rig_emulated.EmulatedRig.close", close)
    out = cli("rerun", stored, "--drive", WRONG_SUM, "--times", "2", status=status).out
    assert "failing: 2 of 2" in out
    assert str(raised) in out


def test_a_rerun_without_a_verdict_is_a_fault_of_the_rig(stored, cli, monkeypatch):
    unjudged = lambda claim, rig: Verdict(claim, Outcome.INCONCLUSIVE, "nothing answers")  # noqa: E731
    monkeypatch.setattr("conformance.cli.rerun.engine.run_claim", unjudged)
    assert "no verdict: nothing answers" in cli("rerun", stored, status=10).out


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"claim": ""}, "got no claim"),
        ({"target": ""}, "got no target"),
        ({"seed": "x"}, "got the seed 'x'"),
        ({"claim": "*/shape/read_speed/*"}, "expected the name of one claim"),
    ],
)
def test_a_stored_failure_that_no_run_wrote(changed, told, tmp_path, cli):
    about = {"claim": "mks-rs485/shape/read_speed/answered", "target": "mks-rs485@1"} | changed
    with (tmp_path / "f.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("servotap.claim", about)
        writer.finish()
    assert told in cli("rerun", tmp_path / "f.mcap", status=2).err


class Wordless(BaseException):
    def __str__(self) -> str:
        raise ValueError


@pytest.mark.parametrize(
    "error", [SystemExit(0), Ended("os._exit(0) was called"), GeneratorExit(), Wordless(), ZeroDivisionError()]
)
def test_a_claim_that_ends_the_program_is_at_fault_and_ends_no_run(error, tmp_path):
    def leaves(probe):
        raise error

    rig = EmulatedPort("mks-can@1", tmp_path)
    verdict = engine.run_claim(claim(rig, leaves), rig)
    assert verdict.outcome is Outcome.INCONCLUSIVE
    assert verdict.reason.startswith(f"a fault of the claim itself: {type(error).__name__}")
    rig.close()


def test_ctrl_c_in_a_claim_ends_the_run(tmp_path):
    def waits(probe):
        raise KeyboardInterrupt

    rig = EmulatedPort("mks-can@1", tmp_path)
    with pytest.raises(KeyboardInterrupt):
        engine.run_claim(claim(rig, waits), rig)
    rig.close()
