"""Arguments of another kind than the Python API expects: one error of ours, which names the argument."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import servotap
from tests import CAPTURES

CAPTURE = CAPTURES / "mks_rs485.log"


@pytest.mark.parametrize("path", ["", None, 5, 3.5, b"a.log", [], object()])
def test_a_path_that_is_none(path: Any) -> None:
    with pytest.raises(servotap.UsageError, match=r"^path: expected a path, as str or os\.PathLike, got "):
        servotap.open(path)


@pytest.mark.parametrize(
    "given",
    [
        {"dialect": 5}, {"dialect": None}, {"dialect": ["mks-rs485"]}, {"model": 5}, {"baud": "x"}, {"baud": 1.5},
        {"baud": True}, {"format": 7}, {"channels": "D0"}, {"channels": [0]}, {"uart": 5}, {"groups": 5}, {"groups": ["x"]},
        {"ids": 5}, {"dbc": 5}, {"dbc": "bus.dbc"}, {"dbc": [b"bus.dbc"]}, {"modbus_map": None}, {"since": 5}, {"until": 5.0},
    ],
    ids=str,
)  # fmt: skip
def test_an_argument_of_another_kind(given: dict[str, Any]) -> None:
    (name,) = given
    with pytest.raises(servotap.UsageError, match=f"^{name}: expected .+, got "):
        servotap.open(CAPTURE, **given)


def test_the_right_kinds_pass() -> None:
    with servotap.open(CAPTURE, dialect="mks-rs485", model="57D", baud=38400, groups={5}, channels=(), since="+0s") as capture:
        assert len(list(capture.frames)) == 39


def test_names_of_a_plot_are_texts() -> None:
    with (
        servotap.open(CAPTURE) as capture,
        pytest.raises(servotap.UsageError, match="names: expected a list, each of them a text"),
    ):
        capture.plot(None)  # type: ignore[arg-type]


NONE = [None, 5, float("nan"), float("inf"), 10**400, b"\xff", [5], object()]


@pytest.mark.parametrize("value", [None, 5, 1.5, 10**12, -1, ["FA"], {}], ids=repr)
def test_a_frame_is_hex_or_bytes(value: Any) -> None:
    with pytest.raises(servotap.UsageError, match=r"^frame: expected hex as a text, or bytes, got "):
        servotap.explain(value)


@pytest.mark.parametrize(
    ("given", "value"),
    [
        *((name, value) for name in ("max_speed", "max_turns") for value in (float("nan"), float("inf"), "5", 10**400, [5])),
        *((name, value) for name in ("timeout", "max_run") for value in (None, float("nan"), float("inf"), -1, 10**400, "5")),
        ("on", 5), ("on", None), ("name", 5), ("allow", 5), ("allow", [5]), ("alone", "yes"), ("log", 5), ("subdivision", 1.5),
        ("cut_power", None),
    ],
)  # fmt: skip
def test_an_argument_of_a_drive_of_another_kind(given: str, value: Any) -> None:
    with pytest.raises(servotap.UsageError, match=f"^{given}: expected .+, got "):
        servotap.drive(**({"name": "mks-rs485@1"} | {given: value}))


@pytest.mark.parametrize("value", NONE, ids=lambda value: str(value)[:20])
def test_what_a_drive_is_asked_for_is_checked_before_it_leaves(value: Any) -> None:
    with servotap.drive("mks-rs485@1,work_mode=sr_vfoc") as drive:
        for call in (drive.read, drive.ask, drive.send):
            with pytest.raises(servotap.UsageError, match=r"^command: expected a text, got "):
                call(value)
        if value != 5:
            with pytest.raises(servotap.UsageError, match=r"^seconds: expected seconds from 0 on, below 1e9, got "):
                drive.wait(value)
            if not isinstance(value, bytes):
                with pytest.raises(servotap.UsageError, match=r"^speed: expected a number, or a text, got "):
                    drive.send("run_speed", direction="cw", speed=value, acceleration=1, allow={"motion", "unbounded"})


@pytest.mark.parametrize("value", NONE, ids=lambda value: str(value)[:20])
def test_names_of_columns_and_a_lake_are_checked(value: Any) -> None:
    with servotap.open(CAPTURE) as capture:
        for name in ("fields", "topics"):
            with pytest.raises(servotap.UsageError, match=r"^listed: expected names"):
                capture.to_arrow(**{name: value})
    with pytest.raises(servotap.UsageError, match=r"^url: expected a path, got "):
        servotap.lake(value)


@pytest.mark.parametrize("command", ["decode", "diagnose", "show", "check"])
def test_an_empty_name_is_not_the_current_folder(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli) -> None:
    (tmp_path / "a.log").write_bytes(CAPTURE.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert "the name of the capture is empty" in cli(command, "", status=2).err
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]
