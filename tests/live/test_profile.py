"""Profiles: where they are looked for, what a name stands for, and what is said of a mistake."""

from __future__ import annotations

import os
import sys

import msgspec
import pytest

from analyzer.cli import main, record
from analyzer.errors import ServotapError, UnreadableError, UsageError
from analyzer.live import profile
from tests import ROOT
from tests.live.test_record_options import parsed

BENCH = """\
[bus.left]
port = "/dev/ttyUSB7"
baud = 115200
parity = "even"
groups = [80]
ids = "1,2"

[drive.arm]
bus = "left"
dialect = "mks-rs485"
address = 1
model = "42d"
subdivision = 16
max-speed = 300
settings = { current = "1600 mA", work_mode = 5 }

[drive.lift]
bus = "left"
dialect = "mks-modbus"
address = 2

[drive.wrist]
port = "can:socketcan:can0"
bitrate = 1000000
dialect = "mks-can"
address = 0x12
model = "42E"
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with nothing above it and no profile of the user."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("APPDATA", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def bench(folder):
    (folder / "servotap.toml").write_text(BENCH)
    return folder


def test_a_drive_brings_its_bus(bench):
    named = profile.look_up("arm")
    assert named.endpoint.text == "left=serial:/dev/ttyUSB7,baud=115200,parity=even"
    assert (named.endpoint.name, named.endpoint.speed, named.endpoint.parity) == ("left", 115200, "E")
    (drive,) = named.drives
    assert (drive.target, drive.text, drive.dialect.name) == ("mks-rs485@1", "mks-rs485@1,model=42D", "mks-rs485")
    assert (drive.entry.max_speed, drive.entry.subdivision) == (300, 16)
    assert named.is_drive


def test_a_bus_has_all_its_drives(bench):
    named = profile.look_up("left")
    assert [drive.name for drive in named.drives] == ["arm", "lift"]
    assert not named.is_drive
    with pytest.raises(UsageError, match=r"left is a bus: which of its drives\? \(arm, lift\)"):
        profile.drive("left")


def test_a_drive_may_have_a_port_of_its_own(bench):
    named = profile.look_up("wrist")
    assert named.endpoint.text == "wrist=can:socketcan:can0,bitrate=1000000"
    assert named.drives[0].target == "mks-can@0x12"


def test_in_a_folder_that_was_removed_the_user_s_profile_counts(bench):
    (bench / "home/servotap").mkdir(parents=True)
    (bench / "home/servotap/servotap.toml").write_text(ARM)
    (bench / "gone").mkdir()
    os.chdir(bench / "gone")
    (bench / "gone").rmdir()
    assert profile.names() == ["arm"]


@pytest.mark.parametrize("text", ["serial:/dev/ttyUSB0", "mks-rs485@1", "mks-rs485", "emulated", "all", "x=tcp:a:1", "-"])
def test_what_is_no_name_is_not_looked_up(folder, text):
    (folder / "servotap.toml").write_text("this is no TOML")
    assert profile.look_up(text) is None


def test_the_nearest_profile_counts_then_the_user_s(bench):
    (bench / "home/servotap").mkdir(parents=True)
    (bench / "home/servotap/servotap.toml").write_text(
        '[drive.arm]\nport = "far"\ndialect = "lk-rs485"\n\n[drive.desk]\nport = "COM3"\ndialect = "lk-rs485"\n'
    )
    (bench / "a/b").mkdir(parents=True)
    os.chdir(bench / "a/b")
    assert profile.look_up("arm").drives[0].dialect.name == "mks-rs485"
    assert profile.look_up("desk").endpoint.place == "COM3"
    (bench / "a/servotap.toml").write_text('[drive.arm]\nport = "near"\ndialect = "mks-modbus"\naddress = 3\n')
    assert profile.look_up("arm").drives[0].target == "mks-modbus@3"
    with pytest.raises(UsageError, match=r"no bus or drive 'lift'"):
        profile.look_up("lift")


ARM = '[drive.arm]\nport = "p"\ndialect = "mks-rs485"\n'
LEFT = '[bus.left]\nport = "p"\n'
MISTAKES = [
    ('[drive.arm]\nport = "p"\ndialct = "x"\n', r"toml, line 3: drive arm: dialct: no key 'dialct'; did you mean dialect\?"),
    (ARM + "max_speed = 3\n", r"line 4: .*no key 'max_speed'; did you mean max-speed"),
    (ARM + 'allow = "motion"\n', r"no key 'allow'; permissions are given on the command line alone"),
    (ARM + 'address = "one"\n', r"line 4: drive arm: address: expected a whole number, got 'one'"),
    (ARM + "address = 300\n", r"line 4: drive arm: address: got 300, expected 1..255"),
    (ARM + "groups = [1, 99999]\n", r"line 4: drive arm: groups: got '99999', an identifier of 29 bits"),
    (ARM + 'ids = "1-x"\n', r"line 4: drive arm: ids: got '1-x', expected addresses from 0 to 2047"),
    (ARM + '"a\\u001Bb" = 1\n', r"drive arm: a\\x1bb: no key 'a\\x1bb' \(there are port"),
    (ARM + "groups = 80\n", r"groups: expected a list, got 80"),
    (ARM + "max-speed = -1\n", r"line 4: drive arm: max-speed: got -1, expected a number above 0"),
    (ARM + "subdivision = 0\n", r"subdivision: got 0, expected 1..256"),
    (ARM + 'model = "99X"\n', r"model: no model '99X' of mks-rs485, expected 42D or 57D"),
    (ARM + "settings = 3\n", r"settings: expected a table, got 3"),
    (ARM + "baud = 0\n", r"line 2: drive arm: port: .*baud: got '0'"),
    ('[drive.arm]\nport = "p"\n', r"line 1: drive arm: no dialect, expected dialect = ..., one of mks-rs485, mks-modbus"),
    ('[drive.arm]\nport = "p"\ndialect = "mks-rs458"\n', r"line 3: .*no dialect 'mks-rs458'; did you mean mks-rs485"),
    ('[drive.arm]\nport = "can:slcan:x"\ndialect = "mks-rs485"\n', r"mks-rs485 is a dialect of serial, and .* is a can bus"),
    ('[drive.arm]\ndialect = "mks-rs485"\n', r'line 1: drive arm: no port, expected port = .* or bus = "NAME"'),
    (LEFT + '[drive.arm]\nbus = "lfet"\ndialect = "mks-rs485"\n', r"line 4: drive arm: bus: no bus 'lfet'; did you mean left"),
    (LEFT + '[drive.arm]\nbus = "left"\nport = "q"\ndialect = "mks-rs485"\n', r"line 5: drive arm: port: got a port and bus"),
    ('[bus.arm]\nport = "p"\n' + ARM, r"arm is a bus, too: give one of them another name"),
    (ARM + ARM, r"cannot declare .*arm.* twice \(at line 4"),
    ("[drive.arm\n", r"servotap.toml: .*\(at line 1"),
    ("[drives.arm]\n", r"line 1: got 'drives'; did you mean drive\?, expected \[bus.NAME\] and \[drive.NAME\]"),
    ("arm = 3\n", r"line 1: got 'arm', expected \[bus.NAME\]"),
    ("[drive]\narm = 3\n", r"expected a table, \[drive.arm\], got 3"),
    ("[drive.alm]\n", r"no bus or drive 'arm' in .*servotap.toml; did you mean alm\? \(there are alm\)"),
    ("", r"no bus or drive 'arm' in .*servotap.toml \(there are none\)"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), MISTAKES)
def test_a_mistake_is_named_with_its_line(folder, text, said):
    (folder / "servotap.toml").write_text(text)
    with pytest.raises(UsageError, match=said):
        profile.look_up("arm")


def test_a_mistake_in_one_entry_does_not_keep_another_from_being_used(folder):
    (folder / "servotap.toml").write_text(ARM + "\n[drive.lift]\nwrong = 3\n[drive.mks-can]\n[bus.x]\n")
    assert profile.look_up("arm").drives[0].target == "mks-rs485@1"
    with pytest.raises(UsageError, match="no key 'wrong'"):
        profile.look_up("lift")


def test_a_name_that_is_a_dialect_cannot_be_a_bus_either(folder):
    (folder / "servotap.toml").write_text(
        '[drive.arm]\nbus = "mks-can"\ndialect = "mks-can"\n[bus.mks-can]\nport = "can:a:b"\n'
    )
    with pytest.raises(UsageError, match=r"line 4: bus mks-can: 'mks-can' is a dialect: expected letters"):
        profile.look_up("arm")


def test_without_a_profile_the_way_to_one_is_told(folder):
    with pytest.raises(UsageError, match=r"'arm' is no endpoint, and there is no servotap.toml with names \(servotap init"):
        profile.look_up("arm")


def test_a_profile_that_cannot_be_read(folder):
    (folder / "servotap.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="expected UTF-8, got byte FF at 0"):
        profile.look_up("arm")
    (folder / "servotap.toml").unlink()
    (folder / "servotap.toml").mkdir()
    with pytest.raises(UnreadableError, match="servotap.toml: Is a directory" if sys.platform != "win32" else "servotap.toml"):
        profile.look_up("arm")
    assert profile.names() == []
    (folder / "servotap.toml").rmdir()
    os.mkfifo(folder / "servotap.toml")
    assert profile.names() == []
    assert issubclass(UnreadableError, ServotapError)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (".".join(["x"] * 200_000) + " = 1\n", "servotap.toml: a key has more than 64 parts"),
        (f"[{' . '.join(['x'] * 200_000)}]\n", "servotap.toml: a key has more than 64 parts"),
        (".".join([r'"\"."', "'.'"] * 100_000) + " = 1\n", "servotap.toml: a key has more than 64 parts"),
        (f"x = {'9' * 5000}\n", r"servotap.toml: exceeds the limit \(4300 digits\)"),
        ("x = " + "[" * 100_000, "servotap.toml: nested too deep for a profile"),
        ("".join(f'[bus.b{n}]\nport = "p"\n' for n in range(60)), r"\(there are b0, .*b49 and 10 more\)"),
    ],
    ids=["dots", "table", "quotes", "digits", "depth", "names"],
)
def test_what_no_profile_holds_costs_a_line(folder, text, said):
    (folder / "servotap.toml").write_text(text)
    with pytest.raises(UsageError, match=said):
        profile.look_up("arm")
    if not said.endswith(r"more\)"):
        with pytest.raises(UsageError, match="beside: expected a profile in TOML"):
            profile.machine_of(text.encode(), "beside")


@pytest.mark.parametrize(
    ("key", "value"),
    [("address", f'"{"a" * 100_000}"'), ("subdivision", f"[{'1, ' * 50_000}]"), ("settings", f'"{"a" * 100_000}"')],
)
def test_a_mistaken_value_is_quoted_in_short(folder, key, value):
    (folder / "servotap.toml").write_text(f"{ARM}{key} = {value}\n")
    with pytest.raises(UsageError, match=rf"drive arm: {key}: expected .*characters\)") as told:
        profile.look_up("arm")
    assert len(str(told.value)) < 300 + len(str(folder))


def test_a_key_may_have_as_many_parts_as_any_profile_needs(folder):
    (folder / "servotap.toml").write_text(f"{'.'.join(['x'] * 64)} = 1 # {'.' * 200} a.b\n{ARM}")
    assert profile.look_up("arm").drives[0].target == "mks-rs485@1"


def test_the_line_of_a_mistake_is_found_at_once_in_any_text(folder):
    (folder / "servotap.toml").write_text(f'x = """\n[{" " * 100_000}\n"""\n[drive.arm]\nport = "/dev/x"\nbogus = 1\n')
    with pytest.raises(UsageError, match="line 6: drive arm: bogus"):
        profile.look_up("arm")


def configured(folder, *words):
    arguments = parsed(*words, "-o", str(folder / "a.mcap"))
    endpoints, named = record._endpoints(arguments)
    return record.configure(arguments, endpoints, record.target_of(arguments), [], named)


def test_record_takes_from_a_profile_what_is_not_said(bench):
    config = configured(bench, "arm", "lift", "wrist")
    assert [(p.bus, p.dialects, p.ids) for p in config.ports] == [
        ("left", ("mks-rs485", "mks-modbus"), (1, 2)), ("wrist", ("mks-can",), None),
    ]  # fmt: skip
    assert (config.model, config.groups) == ("42D,42E", (80,))
    said = configured(bench, "arm", "--dialect", "lk-rs485", "--model", "MG", "--ids", "7")
    assert (said.ports[0].dialects, said.model, said.ports[0].ids) == (("lk-rs485",), "MG", (7,))


def test_frame_takes_a_name(bench, cli):
    assert main(["frame", "arm", "read_speed"]) == 0
    assert cli("frame", "wrist", "read_speed").out.split("\n")[:2] == ["FA 01 32 2D", "12 32 44"]
    # The model's limits count: a 42D takes 3000 mA.
    assert main(["frame", "arm", "set_current", "current=5000"]) == 2


def test_view_says_what_a_name_is(bench, cli):
    assert "arm is a name of servotap.toml, expected a file (servotap record arm --view)" in cli("view", "arm", status=2).err


def test_the_profile_of_the_documentation_is_one(folder):
    page = (ROOT / "docs/profiles.md").read_text()
    text = page.split("```toml\n")[1].split("```")[0]
    (folder / "servotap.toml").write_text(text)
    assert profile.look_up("left").drives[0].entry.max_current == 1600
    assert profile.look_up("wrist").drives[0].target == "mks-can@0x12"
    # Every key is explained there.
    keys = {field.encode_name for field in msgspec.structs.fields(profile.Drive)}
    assert {key for key in keys if f"`{key}`" not in page} == set()
