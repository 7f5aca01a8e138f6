"""`import servotap`: captures as records and data frames."""

from __future__ import annotations

import gzip
import inspect
import os
import subprocess
import sys
from collections import Counter

import matplotlib
import pandas
import polars
import pytest

import servotap
from analyzer.sources.stream import BLOCK
from tests import CAPTURES, ROOT

matplotlib.use("Agg")
LOG = CAPTURES / "mks_rs485.log"


def test_the_import_loads_nothing_heavy():
    code = "import sys, servotap; print(sorted(sys.modules)); print(dir(servotap))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded, names = done.stdout.splitlines()
    for heavy in ("numpy", "pandas", "pyarrow", "msgspec", "can", "serial", "pytest", "hypothesis", "analyzer.catalogue"):
        assert f"'{heavy}'" not in loaded, heavy
    assert names == str(sorted(servotap.__all__))


def test_all_that_is_public_is_there():
    for name in servotap.__all__:
        assert getattr(servotap, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'opne'"):
        servotap.opne  # noqa: B018


def test_python_m_servotap_is_the_command_line():
    done = subprocess.run([sys.executable, "-m", "servotap", "--version"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == f"servotap {servotap.__version__}\n"


def test_all_that_is_public_is_typed():
    """`make lint` checks the types; here that a user's own checker gets them: the marker, and no parameter without one."""
    assert (ROOT / "servotap" / "py.typed").exists()
    functions = [servotap.open, servotap.explain, servotap.drive]
    for kind in (servotap.Capture, servotap.Drive, servotap.Explained, servotap.Frame, servotap.Reply, servotap.Transaction):
        members = [vars(kind)[n] for n in vars(kind) if not n.startswith("__")]
        members = [member.fget if isinstance(member, property) else member for member in members]
        functions += [member for member in members if inspect.isfunction(member) and member.__module__.startswith("servotap")]
    assert len(functions) > 30
    for function in functions:
        signature = inspect.signature(function)
        assert signature.return_annotation is not signature.empty, function
        for parameter in list(signature.parameters.values()):
            assert parameter.name == "self" or parameter.annotation is not parameter.empty, (function, parameter)


# --- records ------------------------------------------------------------------------------------------------------------


def test_frames_are_typed_and_can_be_looked_at_again():
    capture = servotap.open(LOG)
    frames = list(capture.frames)
    assert frames == list(capture.frames)
    assert len(frames) == 39
    speed = next(frame for frame in frames if frame.command == "read_speed" and frame.role == "reply")
    assert (speed["speed"], speed.units, speed.address, speed.bus) == (320, {"speed": "rpm"}, 1, "serial")
    assert speed.latency_ns == 3_000_000
    assert speed.raw == bytes.fromhex("FB013201406F")
    assert speed.time is not None
    assert speed.time.isoformat() == "2026-03-02T09:00:01.143000+00:00"
    run = next(frame for frame in frames if frame.command == "run_speed")
    assert run.fields == {"direction": "ccw", "speed": 320, "acceleration": 2}
    package = next(frame for frame in frames if frame.command == "long_package")
    assert [slot["speed"] for slot in package["slots"]] == [50, 100]


def test_times_are_what_the_capture_has():
    on_can = next(iter(servotap.open(CAPTURES / "mks_can.asc").frames))
    assert on_can.can_id == 1
    assert on_can.time is not None
    assert on_can.time.tzinfo is None
    assert next(iter(servotap.open(CAPTURES / "mks_rs485.bin").frames)).time is None


def test_findings_and_junk(tmp_path):
    assert Counter(found.rule for found in servotap.open(LOG).findings) == {
        "out_of_range": 1, "failed_status": 1, "bad_checksum": 1,
    }  # fmt: skip
    (tmp_path / "a.bin").write_bytes(bytes.fromhex("FA01322D 005577 FA01322D"))
    capture = servotap.open(tmp_path / "a.bin", dialect="mks-rs485")
    assert [(each.reason, each.data) for each in capture.junk] == [("noise", bytes.fromhex("005577"))]


def test_transactions_are_requests_with_their_replies():
    transactions = list(servotap.open(LOG).transactions)
    assert sum(len(each.replies) + 1 for each in transactions) == 39
    outcomes = {(each.first.command, each.outcome) for each in transactions}
    assert outcomes >= {
        ("read_speed", "answered"), ("stop_speed", "silent"), ("set_current", "failed"), ("read_enabled", "damaged"),
    }  # fmt: skip
    move = next(each for each in transactions if each.first.command == "move_relative_pulses")
    assert [reply["status"] for reply in move.replies] == ["starting", "complete"]
    assert move.latency_ns == 3_000_000


def test_requests_that_stay_unanswered_are_told(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes.fromhex("FA01322D FA01312C FB0131000000007FF09C"))
    first, second = servotap.open(tmp_path / "a.bin", dialect="mks-rs485").transactions
    assert (first.first.command, first.outcome, first.reply) == ("read_speed", "unanswered", None)
    assert [found.rule for found in first.findings] == ["unanswered"]
    assert second.outcome == "answered"
    assert second.reply is not None
    assert second.reply["position"] == 32752


def test_a_capture_that_breaks_off_gives_what_came_before(tmp_path):
    whole = gzip.compress(LOG.read_bytes() * 50)
    (tmp_path / "a.log.gz").write_bytes(whole[: len(whole) // 2])
    capture = servotap.open(tmp_path / "a.log.gz")
    with pytest.warns(UserWarning, match="ends too early"):
        frames = list(capture.frames)
    assert len(frames) > 39
    with pytest.warns(UserWarning, match="ends too early"):
        assert len(capture.to_pandas()) >= len(frames)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_fork_in_the_middle_takes_no_bytes_from_the_other_process(tmp_path):
    """Both processes read on in one open file, whose position they share."""
    path, count = tmp_path / "long.log", 3 * BLOCK // 30
    path.write_text("".join(f"({n}.000000) can0 001#F601400238\n" for n in range(10**9, 10**9 + count)))
    frames = iter(servotap.open(path).frames)
    assert next(frames).t_ns == 10**18
    child = os.fork()
    if not child:
        os._exit(0 if sum(1 for _ in frames) == count - 1 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert sum(1 for _ in frames) == count - 1


def test_wrong_use_is_told_at_once(tmp_path):
    with pytest.raises(servotap.UnreadableError, match="No such file"):
        servotap.open(tmp_path / "a.log")
    with pytest.raises(servotap.UsageError, match="mks-rs485"):
        servotap.open(LOG, dialect="mks-rs458")
    with pytest.raises(servotap.UsageError, match="is not a time"):
        servotap.open(LOG, since="soon")
    with pytest.raises(servotap.UsageError, match="did you mean speed"):
        servotap.open(LOG).to_arrow(fields="sped")


def test_a_time_range():
    capture = servotap.open(LOG, since="5s", until="6s")
    assert {frame.command for frame in capture.frames} == {"stop_speed", "move_relative_pulses", "read_angle_error"}
    assert set(capture.to_polars()["command"]) == {"stop_speed", "move_relative_pulses", "read_angle_error"}


# --- tables -------------------------------------------------------------------------------------------------------------


def test_pandas_keeps_whole_numbers_whole():
    table = servotap.open(LOG).to_pandas()
    assert str(table["speed"].dtype) == "Int64"
    assert table["speed"].dropna().tolist() == [320, 320, 0, 320, 600, 0]
    assert str(table["checksum_ok"].dtype) == "boolean"
    assert table["time"].iloc[0] == pandas.Timestamp("2026-03-02T09:00:00Z")
    assert table.attrs["units"]["speed"] == "rpm"
    assert table.attrs["units"]["latency"] == "ms"


def test_wide_tables():
    table = servotap.open(LOG).to_polars(rate="10Hz", topics="state", fields=["speed"])
    assert table.columns == ["time", "elapsed", "/serial/1/state.speed"]
    assert table["/serial/1/state.speed"].to_list() == [320.0] * len(table)
    assert table["elapsed"][1] - table["elapsed"][0] == pytest.approx(0.1)


def test_rows_are_kept_until_the_capture_changes(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(LOG.read_bytes())
    with servotap.open(path) as capture:
        first = capture.to_polars()
        kept = capture._recorded
        assert capture.to_polars().equals(first)
        assert capture._recorded is kept
        lines = LOG.read_text().splitlines(keepends=True)
        path.write_text("".join(lines[:-1]))
        assert len(capture.to_polars()) < len(first)


@pytest.mark.parametrize(("way", "package"), [("to_pandas", "pandas"), ("to_polars", "polars"), ("to_arrow", "pyarrow")])
def test_a_missing_package_is_named(way, package, monkeypatch):
    capture = servotap.open(LOG)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(servotap.UsageError, match=f"needs {package}, which is not installed: pip install"):
        getattr(capture, way)()


def test_plots_show_the_values_with_their_units():
    axes = servotap.open(LOG).plot("speed", "angle_error")
    assert [axis.get_ylabel() for axis in axes] == ["speed [rpm]", "angle_error [deg]"]
    (speed,) = axes[0].get_lines()
    assert servotap.open(LOG).plot("read_speed.speed")[0].get_lines()[0].get_label() == "serial/1/read_speed/reply"
    assert (list(speed.get_xdata()), list(speed.get_ydata())) == ([1.143], [320.0])
    assert speed.get_label() == "serial/1/state"
    matplotlib.pyplot.close("all")
    with pytest.raises(servotap.UsageError, match="did you mean position"):
        servotap.open(LOG).plot("positon")
    with pytest.raises(servotap.UsageError, match="'status' is no number here"):
        servotap.open(LOG).plot("status")


# --- explain ------------------------------------------------------------------------------------------------------------


def test_explain_prints_as_the_command_line_does(cli):

    for frame in ("FA 01 F6 0F A0 02", "FA 01 31 2C FB 01 31 00 00 00 00 7F F0 9C", "001#F60140023A"):
        assert str(servotap.explain(frame)) + "\n" == cli("explain", frame).out


def test_explain_takes_bytes_and_says_what_is_wrong():
    found = servotap.explain(bytes.fromhex("FA01F60FA002"))
    assert (found.dialect, found.command, found.findings) == ("mks-rs485", "run_speed", ["bad_checksum", "out_of_range"])
    assert found.as_objects()[0]["command"] == "run_speed"
    answer = servotap.explain("01 04 02 01 40 B9 50", request="01 04 00 32 00 01 90 05")
    assert answer.command == "read_speed"
    with pytest.raises(servotap.UnreadableError):
        servotap.explain("no frame")
    with pytest.raises(servotap.UsageError, match="expected 'request' or 'reply'"):
        servotap.explain("FA 01 31 2C", role="host")


def test_polars_has_the_same_rows_as_the_frames():
    capture = servotap.open(CAPTURES / "lk_rs485.log")
    table = capture.to_polars().filter(polars.col("role").is_in(["request", "reply"]))
    for row, frame in zip(table.rows(named=True), capture.frames, strict=True):
        assert row["command"] == frame.command
        assert (row["latency"] is None) == (frame.latency_ns is None)
        for name, value in frame.fields.items():
            unit = frame.units.get(name, "")
            shown = next(v for c, v in row.items() if c == name or (unit and c.startswith(f"{name}_") and v is not None))
            assert shown == (str(value) if isinstance(shown, str) else value)
