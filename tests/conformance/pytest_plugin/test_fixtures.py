"""The fixtures that other people's tests get from the plugin."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import can
import msgspec
import pytest
import serial

import servotap
from analyzer.records import CanFrame
from conformance.pytest_plugin import fixtures, plan, plugin, reports
from conformance.suite.record import VerdictRecord


def test_a_program_opens_the_port_of_drives(servo_port):
    with serial.Serial(servo_port("mks-rs485@1", "mks-rs485@2"), 38400, timeout=5) as port:
        port.write(bytes.fromhex("FA 02 32 2E"))
        assert port.read(6) == bytes.fromhex("FB 02 32 00 00 2F")


def test_a_line_in_virtual_time(servo_line):
    line = servo_line("mks-can@1")
    line.write(CanFrame(None, "can", 1, bytes.fromhex("32 33")))
    answer = line.receive(1_000_000_000)
    assert answer.data == bytes.fromhex("32 00 00 33")
    assert line.now_ns() < 10_000_000


def test_a_bus_of_python_can(servo_can_bus):
    bus, other = servo_can_bus("mks-can@1", "mks-can@2"), servo_can_bus("mks-can@1")
    for address in (2, 1):
        bus.send(can.Message(arbitration_id=address, data=bytes((0x32, 0x32 + address)), is_extended_id=False))
        answer = bus.recv(5)
        assert answer is not None
        assert (answer.arbitration_id, answer.data) == (address, bytes((0x32, 0, 0, 0x32 + address)))
    # Each bus is its own.
    assert other.recv(0.05) is None


# --- in runs of others --------------------------------------------------------------------------------------------------

ROOT = Path(__file__).parents[3]
#: Another plugin's options, by the names that the suite has where it is run itself.
OTHERS = """\
def pytest_addoption(parser):
    for name in ("--drive", "--on", "--report", "--log", "--seed", "--alone"):
        parser.addoption(name)
"""


def example():
    """Return the tests that the page shows."""
    page = (ROOT / "docs" / "proving.md").read_text()
    part = page[page.index("## Drives for your own tests") : page.index("## Your own claims")]
    lines = [line[4:] for line in part.splitlines() if not line or line.startswith("    ")]
    return "\n".join(line for line in lines if not line.startswith("pytest ")), [
        line.split()[1:] for line in lines if line.startswith("pytest ")
    ]


def run(folder, *words):
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rs", *words]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False)
    return done.returncode, done.stdout + done.stderr


def test_the_example_of_the_page_runs_on_an_emulated_drive(tmp_path):
    (tmp_path / "conftest.py").write_text(OTHERS)
    code, (words, _) = example()
    (tmp_path / "test_axis.py").write_text(code)
    status, out = run(tmp_path, *words, "--report", "theirs")
    assert status == 0, out
    assert "5 passed" in out


def test_the_same_tests_run_on_a_real_drive(tmp_path, servo_port):
    code, (_, words) = example()
    assert words[2:4] == ["--servo-on", "serial:/dev/ttyUSB0,baud=38400"]
    (tmp_path / "test_axis.py").write_text(code)
    words[3] = f"serial:{servo_port('mks-rs485@1,work_mode=sr_vfoc')},baud=38400"
    # Two workers, and one port: its tests go to one of them.
    status, out = run(tmp_path, *words, "-n", "2", "-k", "stands or quarter")
    assert status == 0, out
    assert "2 passed" in out


def test_what_is_not_allowed_fails_and_a_drive_that_is_missing_is_an_error(tmp_path, servo_port):
    (tmp_path / "test_mine.py").write_text(
        "def test_mine(servo_drive):\n    servo_drive.send('run_speed', direction='cw', speed=60, acceleration=200)\n"
    )
    status, out = run(tmp_path, "--servo-drive", "mks-rs485@1", "--servo-drive", "mks-can@1")
    assert status == 1
    assert out.count("needs motion, unbounded") >= 2, out
    port = f"port = '{servo_port('mks-rs485@1')}'"
    (tmp_path / "servotap.toml").write_text(f"[drive.gone]\n{port}\nbaud = 38400\ndialect = 'mks-rs485'\naddress = 5\n")
    status, out = run(tmp_path, "--servo-on", "gone")
    assert status == 1
    assert "servotap: mks-rs485@5 does not answer" in out, out
    assert "Traceback" not in out


def test_a_drive_that_is_none_is_wrong_use():
    options = {f"servotap_{name.replace('-', '_')}": about["default"] for name, about in plugin.OPTIONS}
    config = SimpleNamespace(getoption=(options | {"servotap_drive": ["mks-rs486@5"]}).__getitem__)
    with pytest.raises(pytest.UsageError, match="did you mean"):
        fixtures.drives_of(config)


def test_a_profile_brings_the_bounds(tmp_path, monkeypatch):
    entry = "[drive.arm]\nport = '/dev/x'\nbaud = 38400\ndialect = 'mks-rs485'\nmax-speed = 50\nsubdivision = 16\n"
    (tmp_path / "servotap.toml").write_text(entry)
    monkeypatch.chdir(tmp_path)
    options = {f"servotap_{name.replace('-', '_')}": about["default"] for name, about in plugin.OPTIONS}
    config = SimpleNamespace(getoption=(options | {"servotap_drive": ["arm"], "servotap_allow": ["motion"]}).__getitem__)
    asked = {}
    monkeypatch.setattr(servotap, "drive", lambda *names, **bounds: asked.update(bounds, names=names) or Closing())
    (parameter,) = fixtures.drives_of(config)
    (target,) = parameter.values
    with fixtures.connected(target, config):
        pass
    assert asked["names"] == ("mks-rs485@1", "arm=serial:/dev/x,baud=38400")
    assert (asked["max_speed"], asked["subdivision"], asked["allow"]) == (50, 16, ["motion"])


class Closing:
    """A drive that was closed."""

    def close(self):
        pass


class Group:
    """What another plugin has left of the names."""

    def __init__(self):
        self.names = []

    def getgroup(self, *words):
        return self

    def addoption(self, *names, **about):
        if "--report" in names:
            raise ValueError
        self.names += names


class Manager:
    """A run with these words."""

    def __init__(self, *words):
        self.invocation_params = SimpleNamespace(args=words)

    def getplugin(self, name):
        return self


@pytest.mark.parametrize(
    ("words", "bare"),
    [
        (("--pyargs", "conformance", "--drive", "x"), True),
        (("--pyargs", "conformance.pytest_plugin.test_manual::test_claim"), True),
        (("tests", "--servo-drive", "x"), False),
        (("conformance",), False),
        (("--pyargs", "conformance_of_others"), False),
    ],
)
def test_options_stand_without_prefix_only_where_the_suite_is_run(words, bare):
    group = Group()
    plugin.pytest_addoption(group, Manager(*words))
    assert {"--servo-drive", "--servo-on", "--servo-report", "--servo-seed"} <= set(group.names)
    assert ("--drive" in group.names, "--max-speed" in group.names) == (bare, bare)
    # What another plugin has, and what would be anyone's.
    assert not {"--report", "--seed"} & set(group.names)


@pytest.mark.parametrize(
    ("drives", "places", "became"),
    [
        ([], ["arm"], (["arm"], [])),
        ([], ["emulated"], ([], ["emulated"])),
        ([], ["serial:/dev/x"], ([], ["serial:/dev/x"])),
        (["mks-can@1"], ["left"], (["mks-can@1"], ["left"])),
    ],
)
def test_a_word_at_servo_on_names_a_drive_of_a_profile(drives, places, became):
    option = SimpleNamespace(servotap_drive=drives, servotap_on=places)
    plugin._names_as_drives(option)
    assert (option.servotap_drive, option.servotap_on) == became


@pytest.mark.parametrize(("outcomes", "status"), [(["not run"], 10), (["inconclusive"], 10), (["confirmed", "not run"], 0)])
def test_a_run_in_which_no_claim_has_a_verdict_is_no_success(outcomes, status):
    defaults = {f"servotap_{name.replace('-', '_')}": about["default"] for name, about in plugin.OPTIONS}
    config = SimpleNamespace(stash=pytest.Stash(), getoption=defaults.__getitem__)
    common = dict.fromkeys(("id", "target", "theme", "dialect", "statement", "section", "certainty", "refuted_by"), "")
    records = [VerdictRecord(outcome=outcome, **common) for outcome in outcomes]
    reports.judge(config, [msgspec.json.encode(record).decode() for record in records])
    assert config.stash.get(plugin.STATUS, 0) == status


@pytest.mark.parametrize(("option", "said"), [("max_run", "nan"), ("max_run", "-1"), ("max_inconclusive", "nan")])
def test_an_option_that_servotap_test_refuses_is_wrong_use_here_too(option, said):
    options = {f"servotap_{name.replace('-', '_')}": about["default"] for name, about in plugin.OPTIONS}
    config = SimpleNamespace(getoption=(options | {f"servotap_{option}": said}).__getitem__)
    with pytest.raises(pytest.UsageError, match=f"--{option.replace('_', '-')}: expected .*, got {said}"):
        plan.arguments_of(config)
