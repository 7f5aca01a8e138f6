"""Arguments of another kind than the Python API expects: one error of ours, which names the argument."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import servotap
from analyzer.cli import main

CAPTURE = Path(__file__).parents[2] / "captures" / "mks_rs485.log"


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


@pytest.mark.parametrize("command", ["decode", "diagnose", "show", "check"])
def test_an_empty_name_is_not_the_current_folder(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.log").write_bytes(CAPTURE.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert main([command, ""]) == 2
    assert "the name of the capture is empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]
