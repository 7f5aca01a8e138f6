"""Completion of the shell: asked as a shell asks, and once through a real bash."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from analyzer.cli.completion import complete
from analyzer.errors import UsageError

SERVOTAP = os.path.join(os.path.dirname(sys.executable), "servotap")


def completed(line: str, tmp_path) -> list[str]:
    """Return what completes the end of a line."""
    out = tmp_path / "answer"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_SUPPRESS_SPACE": "1", "COMP_TYPE": "9"}
    asked |= {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_STDOUT_FILENAME": str(out)}
    done = subprocess.run([SERVOTAP], env=os.environ | asked, cwd=tmp_path, capture_output=True, text=True)
    assert done.stderr == ""
    return out.read_text().split("\n")


@pytest.mark.parametrize(
    ("line", "has", "lacks"),
    [
        ("servotap sh", ["show"], ["send"]),
        ("servotap scan --ad", ["--addresses"], ["--busy"]),
        ("servotap show --dialect lk", ["lk-rs485"], ["mks-can"]),
        ("servotap record --dialect mks-can,lk", ["mks-can,lk-rs485"], []),
        ("servotap send mks-", ["mks-rs485@1", "mks-can@1"], ["lk-rs485@1"]),
        ("servotap send lk-rs485@1 mo", ["motor_on", "move_increment"], ["run_speed"]),
        ("servotap frame mks-rs485@1 run_speed ", ["direction=", "speed=", "acceleration="], ["pulses="]),
        ("servotap frame mks-rs485@1 run_speed direction=", ["direction=cw", "direction=ccw"], []),
        ("servotap send mks-can@1 enable --allow motion,tor", ["motion,torque"], []),
        ("servotap stop serial:x lk", ["lk-rs485@1"], ["mks-can@1"]),
        ("servotap emulate mks", ["mks-modbus@1"], []),
        ("servotap catalogue read_sp", ["read_speed"], ["run_speed"]),
        ("servotap record left=can", ["left=can:slcan:"], []),
        ("servotap test mks-can@1 --on tc", ["tcp:"], []),
        ("servotap send mks-nothing@1 ", [], ["run_speed"]),
    ],
)
def test_what_a_line_is_completed_by(line, has, lacks, tmp_path):
    # A shell breaks words at : and =; what stands before the last break is not repeated.
    breaks = [word[word.rfind(c) + 1 :] for word in line.split(" ")[-1:] for c in "=" if c in word]
    answer = completed(line, tmp_path)
    start = line.split(" ")[-1][: -len(breaks[0]) or None] if breaks else ""
    whole = {each if each.startswith(start) else start + each for each in answer}
    assert set(has) <= whole
    assert not whole & set(lacks)


def test_names_of_a_profile_are_completed_and_their_commands(tmp_path):
    (tmp_path / "servotap.toml").write_text('[drive.elbow]\nport = "/dev/ttyUSB7"\ndialect = "lk-rs485"\n')
    assert "elbow" in completed("servotap send el", tmp_path)
    assert "elbow" in completed("servotap record el", tmp_path)
    assert "elbow" in completed("servotap stop el", tmp_path)
    answer = completed("servotap send elbow mo", tmp_path)
    assert "motor_on" in answer
    assert "move_relative_pulses" not in answer
    (tmp_path / "servotap.toml").write_text("nonsense")
    assert "mks-can@1" in completed("servotap send mks", tmp_path)


def test_the_code_for_each_shell(cli):
    for shell in ("bash", "zsh", "fish"):
        assert "servotap" in cli("completion", shell).out
    assert "expected one of bash, zsh, fish" in cli("completion", "tcsh", status=2).err


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes():
    script = f"""
        PATH={os.path.dirname(SERVOTAP)}:$PATH
        source <(servotap completion bash)
        COMP_LINE='servotap cat' COMP_POINT=12 COMP_TYPE=9 COMP_CWORD=1 COMP_WORDS=(servotap cat)
        _python_argcomplete servotap cat servotap
        echo "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=30)
    assert done.stdout.split() == ["catalogue"], done.stderr


def test_a_shell_that_sets_no_numbers_is_told(monkeypatch):
    for name, value in {"COMP_LINE": "servotap de", "COMP_POINT": "abc"}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(UsageError, match="COMP_POINT: expected a number"):
        complete({})
