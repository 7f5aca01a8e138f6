"""How a run ends: what counts most, and that a drive whose replies cannot be read is refuted and not moved."""

from __future__ import annotations

import pytest

from conformance.claim import worst
from conformance.suite.record import most_inconclusive, too_inconclusive
from tests.conformance.drives.served import on_pty
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
    ("most", "inconclusive", "confirmed", "not_run", "too_many"),
    [("10%", 1, 9, 0, False), ("10%", 2, 9, 90, True), ("3", 3, 0, 0, False), ("3", 4, 100, 0, True), ("100%", 5, 0, 0, False)],
)
def test_many_inconclusive_claims_are_no_success(most, inconclusive, confirmed, not_run, too_many):
    records = [Record("inconclusive")] * inconclusive + [Record("confirmed")] * confirmed + [Record("not run")] * not_run
    assert bool(too_inconclusive(records, most_inconclusive(most))) is too_many


@pytest.mark.parametrize("text", ["x", "-1", "101%", "0.5", ""])
def test_a_limit_that_is_none(text):
    with pytest.raises(ValueError):
        most_inconclusive(text)


def test_a_drive_whose_replies_cannot_be_read_is_refuted_and_not_moved(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with on_pty("mks-rs485@1,work_mode=sr_vfoc,fault=checksum-wrong") as path:
        status = main(
            ["test", "mks-rs485@1", "--on", f"serial:{path},baud=38400", *ALL, "--claim", "mks-rs485/motion/run_speed/*"]
        )
    out, err = capsys.readouterr()
    assert status == 1, err
    assert "NOT STOPPED" not in err
    assert "REFUTED  mks-rs485/shape/read_speed/checksum" in out
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
