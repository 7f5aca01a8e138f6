"""What `servotap record` is asked for: options, their limits, and the commands that its help shows."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import stat

import pytest

from analyzer.cli import main, option_types, record
from analyzer.errors import UsageError
from analyzer.live.config import RecordingConfig
from analyzer.live.log_parts import LogParts
from analyzer.live.spool import spool_folder


def parsed(*words):
    parser = argparse.ArgumentParser()
    record.add_arguments(parser)
    return parser.parse_intermixed_args(list(words))


def configured(tmp_path, *words):
    arguments = parsed(*words, *(() if "-o" in words else ("-o", str(tmp_path / "a.mcap"))))
    endpoints, _ = record._endpoints(arguments)
    target = record.target_of(arguments)
    return record.configure(arguments, endpoints, target, [])


COMMANDS = re.findall(r"^  servotap (record .*)$", record.EXAMPLES, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_of_the_help_is_understood(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    words = shlex.split(command)[1:]
    assert shlex.split(command, posix=False)[1:] == words, "nothing in it needs quoting"
    arguments = parsed(*words)
    config = record.configure(arguments, record._endpoints(arguments)[0], record.target_of(arguments), [])
    assert config.ports
    assert config.log.startswith(str(tmp_path))
    if arguments.duration:
        assert option_types.duration_ns(arguments.duration) == 600 * 10**9


def test_the_help_shows_enough_commands():
    assert len(COMMANDS) >= 6


def test_each_endpoint_of_the_help_is_one(tmp_path):
    """The lines that say how endpoints are written, with their words replaced by values."""
    values = {"PORT": "1", "N": "9600", "NUMBER": "A1", "HOST": "host", "INTERFACE": "slcan", "CHANNEL": "x"}
    for line in re.findall(r"^  \[NAME=\](\S+)", record.EXAMPLES, re.MULTILINE):
        text = re.sub(r"\[,[^\]]*\]", "", line)
        for word, value in values.items():
            text = re.sub(rf"\b{re.escape(word)}\b", value, text)
        assert record.parse_all([text])


def test_what_is_told_to_the_other_processes(tmp_path):
    config = configured(
        tmp_path,
        "left=serial:/dev/ttyUSB0,baud=115200,direction=request", "left=serial:/dev/ttyUSB1,baud=115200,direction=reply",
        "arm=can:slcan:/dev/ttyACM0,bitrate=250000", "tcp:h:1", "can:socketcan:can0", "serial:/dev/ttyS0",
        "--dialect", "mks-rs485,mks-can", "--model", "57d", "--group", "0x10", "--group", "3", "--late", "20",
        "--rotate", "100MB,10min", "--keep", "5", "--max-total", "2GB", "--raw-only",
    )  # fmt: skip
    assert isinstance(config, RecordingConfig)
    assert [(p.stem, p.bus, p.kind, p.direction, p.speed, p.dialects) for p in config.ports] == [
        ("1-left-request", "left", "serial", "request", 115200, ("mks-rs485",)),
        ("2-left-reply", "left", "serial", "reply", 115200, ("mks-rs485",)),
        ("3-arm", "arm", "can", "unknown", 250000, ("mks-can",)),
        ("4-h_1", "h_1", "serial", "unknown", None, ("mks-rs485",)),
        ("5-can0", "can0", "can", "unknown", None, ("mks-can",)),
        ("6-ttyS0", "ttyS0", "serial", "unknown", 38400, ("mks-rs485",)),
    ]
    assert [p.byte_ns for p in config.ports] == [86805, 86805, 0, 0, 0, 260416]
    assert (config.model, config.groups, config.late_ns) == ("57d", (16, 3), 20_000_000)
    assert (config.rotate_bytes, config.rotate_ns, config.keep, config.max_total) == (10**8, 600 * 10**9, 5, 2 * 10**9)
    assert config.raw_only


def test_without_a_dialect_it_is_to_be_found_out(tmp_path):
    assert configured(tmp_path, "serial:/dev/ttyS0").ports[0].dialects == ()


@pytest.mark.parametrize(("dialect", "baud"), [("lk-rs485", 115200), ("mks-rs485", 38400), ("auto", 38400)])
def test_a_port_without_a_rate_has_that_of_its_dialect_and_it_is_said(capsys, dialect, baud):
    arguments = parsed("arm=serial:/dev/ttyUSB0", "--dialect", dialect)
    (endpoint,), _ = record._endpoints(arguments)
    notes = []
    at = record._at_its_speed(endpoint, record.dialects_of(arguments, [endpoint])["arm"], notes, quiet=False)
    assert at.speed == baud
    assert at.text.endswith(f"serial:/dev/ttyUSB0,baud={baud}")
    assert notes == [f"arm: no baud given: {baud} is taken (baud=auto listens at each rate)"]
    assert notes[0] in capsys.readouterr().err


def test_a_log_in_a_folder_and_without_a_name_is_called_after_the_time(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in (["-o", "."], ["-o", str(tmp_path)], []):
        arguments = parsed("serial:/dev/ttyS0", *words)
        assert re.fullmatch(r"recording-\d{8}-\d{6}\.mcap", record.target_of(arguments).name)


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("taken", ["noon.mcap", "noon.mcap.spool", "noon-0001.mcap"])
def test_a_name_of_the_time_that_is_taken_gets_a_number(tmp_path, monkeypatch, taken, force):
    monkeypatch.setattr(record.time, "strftime", lambda form: "noon.mcap")
    arguments = parsed("serial:/dev/ttyS0", "-o", str(tmp_path), *["--force"] * force)
    (tmp_path / taken).mkdir()
    for name in ("noon-2.mcap", "noon-3.mcap"):
        target = record.target_of(arguments)
        assert (target, arguments.replaces) == (tmp_path / name, [])
        target.touch()


def test_foxglove_takes_a_place_and_no_endpoint(tmp_path):
    assert configured(tmp_path, "serial:A", "--foxglove").foxglove == record.FOXGLOVE
    assert configured(tmp_path, "serial:A", "--foxglove", "0.0.0.0:99").foxglove == "0.0.0.0:99"
    config = configured(tmp_path, "--foxglove", "serial:A")
    assert config.foxglove == record.FOXGLOVE
    assert [p.endpoint for p in config.ports] == ["serial:A"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "no endpoint given"),
        (["serial:A", "--dialect", "mks"], "no dialect"),
        (["serial:A", "--dialect", "mks-can"], "none is recorded"),
        (["serial:A", "--model", "99Z"], "no model"),
        (["serial:A", "--rotate", "often"], "expected a size as 100MB or a time as 10min"),
        (["serial:A", "--rotate", "0MB"], "expected a size"),
        (["serial:A", "--keep", "3"], "--keep needs --rotate"),
        (["serial:A", "--max-total", "lots"], "expected a size"),
        (["serial:A", "-o", "/dev/null"], "not a regular file"),
        (["serial:A", "-o", "log.bag"], "ends in .mcap"),
        (["serial:A", "-o", "no/such/folder/a.mcap"], "is no folder"),
        (["serial:A", "serial:A"], "stands there twice"),
    ],
)
def test_what_cannot_be_done_is_said(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=said):
        configured(tmp_path, *words)


@pytest.mark.parametrize(
    ("option", "value"), [("--group", "0x800"), ("--late", "0"), ("--late", "soon"), ("--keep", "0"), ("--keep", "-1")]
)
def test_a_value_that_is_none_is_refused(option, value, capsys):
    with pytest.raises(SystemExit) as refused:
        parsed("serial:A", f"{option}={value}")
    assert refused.value.code == 2
    assert option in capsys.readouterr().err


def test_json_and_view_exclude_each_other():
    with pytest.raises(UsageError, match="exclude each other"):
        record.run(parsed("serial:A", "--json", "--view"))


def test_what_is_in_the_way_is_named_or_replaced_with_force(tmp_path):
    def replaced(*words):
        arguments = parsed("serial:A", "-o", str(log), "--force", *words)
        record.target_of(arguments)
        return arguments.replaces

    log = tmp_path / "a.mcap"
    spool = tmp_path / "a.mcap.spool"
    parts = [tmp_path / "a-0001.mcap", tmp_path / "a-0002.mcap"]
    for path in (log, *parts):
        path.write_bytes(b"x")
    spool.mkdir()
    with pytest.raises(UsageError, match="servotap recover"):
        configured(tmp_path, "serial:A")
    shutil.rmtree(spool)
    with pytest.raises(UsageError, match=r"a\.mcap exists"):
        configured(tmp_path, "serial:A")
    with pytest.raises(UsageError, match=r"a-0001\.mcap exists"):
        configured(tmp_path, "serial:A", "--rotate", "1MB")
    spool.mkdir()
    assert replaced() == [spool, log]
    assert replaced("--rotate", "1MB") == [spool, *parts]
    assert all(path.exists() for path in (log, spool, *parts))


@pytest.mark.parametrize("words", [["serial:/dev/no-such-port,baud=9600"], ["serial:A", "--dialect", "mks"]])
def test_a_recording_that_does_not_begin_replaces_nothing(tmp_path, words, capsys):
    log, spool, part = tmp_path / "a.mcap", tmp_path / "a.mcap.spool", tmp_path / "a-0001.mcap"
    spool.mkdir()
    for path in (log, spool / "unread", part):
        path.write_bytes(b"x")
    assert main(["record", *words, "-o", str(log), "--force"]) == 2
    assert main(["record", *words, "-o", str(log), "--force", "--rotate", "1MB"]) == 2
    assert all(path.exists() for path in (log, spool / "unread", part))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a-0001.mcap", "a.mcap", "a.mcap.spool"]


# --- amounts --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "seconds"), [("10s", 10), ("1.5h", 5400), ("5min", 300), ("2m", 120), ("250ms", 0.25), ("1d", 86400)]
)
def test_times(text, seconds):
    assert option_types.duration_ns(text) == seconds * 10**9


@pytest.mark.parametrize(
    ("text", "size"), [("500kB", 500_000), ("100mb", 10**8), ("2GiB", 2 << 30), ("0.5 TB", 5 * 10**11), ("7B", 7)]
)
def test_sizes(text, size):
    assert option_types.size_bytes(text) == size
    assert option_types.is_size(text)


@pytest.mark.parametrize("text", ["", "10", "s", "-5s", "0s", "1e3s", "5 parsecs", "10MB", "ten s"])
def test_no_times(text):
    with pytest.raises(UsageError, match="expected a time"):
        option_types.duration_ns(text)


@pytest.mark.parametrize("text", ["", "10", "MB", "-5MB", "0B", "5min", "10 s"])
def test_no_sizes(text):
    with pytest.raises(UsageError, match="expected a size"):
        option_types.size_bytes(text)


def test_amounts_for_reading():
    assert [option_types.size_text(n) for n in (0, 999, 1500, 2_500_000, 7.25e9)] == [
        "0 B",
        "999 B",
        "1.5 kB",
        "2.5 MB",
        "7.2 GB",
    ]
    times = [option_types.duration_text(int(s * 1e9)) for s in (0.25, 59.9, 247, 3753)]
    assert times == ["0.2 s", "59.9 s", "4:07 min", "1:02:33 h"]


def test_who_is_a_drive_is_said_for_all_buses_or_by_bus(tmp_path):
    endpoints = ("left=can:socketcan:can0", "arm=can:socketcan:can1")
    config = configured(tmp_path, *endpoints, "--ids", "1,0x123-0x124", "--ids", "arm=7")
    assert [port.ids for port in config.ports] == [(1, 0x123, 0x124), (7,)]
    assert [port.ids for port in configured(tmp_path, *endpoints).ports] == [None, None]
    with pytest.raises(UsageError, match="--ids: no bus 'amr'; did you mean arm"):
        configured(tmp_path, *endpoints, "--ids", "amr=7")


def test_a_log_that_replaces_a_private_one_is_private(tmp_path):
    old = tmp_path / "a.mcap"
    old.write_bytes(b"old")
    old.chmod(0o600)
    config = configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600", "-o", str(old), "--force")
    assert config.mode == 0o600
    old.unlink()
    spool_folder(old).mkdir()
    parts = LogParts(spool_folder(old), config)
    parts.begin(1, lambda: None).abandon()
    parts.close()
    assert stat.S_IMODE(old.stat().st_mode) == 0o600


def test_a_link_that_leads_nowhere_or_in_a_circle_is_no_log(tmp_path):
    for name, target in (("dangling", tmp_path / "none" / "x.mcap"), ("circle", tmp_path / "circle.mcap")):
        link = tmp_path / f"{name}.mcap"
        link.symlink_to(target)
        for force in ((), ("--force",)):
            with pytest.raises(UsageError, match="a link that leads to no file"):
                configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600", "-o", str(link), *force)
        assert link.is_symlink()


def test_a_link_to_a_log_stays_and_the_log_behind_it_is_replaced(tmp_path):
    log, link = tmp_path / "kept/behind.mcap", tmp_path / "link.mcap"
    log.parent.mkdir()
    log.write_bytes(b"old")
    link.symlink_to(log)
    config = configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600", "-o", str(link), "--force")
    assert config.log == str(log)


@pytest.mark.parametrize("wall_ns", [-1, 1 << 62])
def test_a_clock_that_no_log_can_hold_is_told(wall_ns, tmp_path, monkeypatch):
    monkeypatch.setattr("time.time_ns", lambda: wall_ns)
    with pytest.raises(UsageError, match="set it to a time before 2116"):
        configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600")


def test_a_part_is_never_written_through_a_link(tmp_path):
    config = configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600", "--rotate", "1MB")
    folder = spool_folder(tmp_path / "a.mcap")
    folder.mkdir()
    parts = LogParts(folder, config)
    parts.begin(1, lambda: None).abandon()
    (tmp_path / "a-0002.mcap").symlink_to(tmp_path / "elsewhere")
    parts.begin(2).abandon()
    parts.close()
    assert parts.path.name == "a-0003.mcap"
    assert not (tmp_path / "elsewhere").exists()


def test_what_may_wait_for_decoding(tmp_path):
    assert configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600").max_spool == 10**9
    assert configured(tmp_path, "serial:/dev/ttyUSB0,baud=9600", "--max-spool", "50MB").max_spool == 50 * 10**6
