"""What a log holds: nothing is lost by thinning, and counts are those of the summary."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from analyzer.cli import main
from analyzer.report.kept import Marks, extremes
from analyzer.report.traffic import Traffic
from analyzer.sources import open_source
from tests import CAPTURES


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300), st.integers(4, 60))
def test_thinning_keeps_the_ends_and_every_peak(values, most):
    column = np.array(values)
    kept = extremes(column, most)
    assert len(kept) <= most or len(kept) == len(values)
    assert list(kept) == sorted(set(kept.tolist()))
    assert {0, len(values) - 1} <= set(kept.tolist())
    assert column[kept].min() == column.min()
    assert column[kept].max() == column.max()


@given(st.lists(st.integers(1, 40), max_size=30), st.integers(2, 50))
def test_of_many_marks_each_so_many_th_is_kept(batches, most):
    marks, at = Marks("motion", "run_speed"), 0
    for size in batches:
        times = list(range(at, at + size))
        marks.add(times, times, [str(t) for t in times], most)
        at += size
    assert marks.count == at
    assert len(marks.t_ns) <= most
    step = marks.t_ns[1] if len(marks.t_ns) > 1 else max(at, 1)
    assert marks.t_ns == list(range(0, at, step))
    assert [marks.text(n) for n in range(len(marks.t_ns))] == [str(t) for t in marks.t_ns]


def traffic_of(capture, folder, *words):
    log = folder / "x.mcap"
    assert main(["decode", str(capture), "-o", str(log), "--force", *words]) == 0
    with open_source(log) as source:
        traffic = Traffic(source, -(1 << 63), 1 << 63)
        traffic.read()
    return traffic


def test_a_log_gives_values_latencies_marks_and_findings(tmp_path):
    traffic = traffic_of(CAPTURES / "mks_rs485.log", tmp_path)
    drive = traffic.drives["serial", "1"]
    assert (traffic.frames, drive.requests, drive.replies) == (39, 16, 19)
    assert drive.states["speed"].columns()[2].tolist() == [320]
    assert {label: marks.kind for label, marks in drive.marks.items()} == {
        "enable": "enable", "run_speed": "motion", "stop_speed": "stop", "move_relative_pulses": "motion",
        "move_relative_axis": "motion", "emergency_stop": "stop", "! out_of_range": "error", "! failed_status": "error",
        "! bad_checksum": "error",
    }  # fmt: skip
    assert drive.marks["run_speed"].text(0) == "direction=ccw speed=320 rpm acceleration=2"
    # The last reply to a move tells how long the move took, not the drive's latency.
    assert traffic.talks["serial", "move_relative_pulses"].latencies.greatest == 3_000_000
    (found,) = traffic.breaches["out_of_range"].first
    assert (found.raw, found.fields) == ("FA 01 83 17 70 05", "current=6000 mA")


def test_a_drive_on_can_goes_by_its_identifier(tmp_path):
    traffic = traffic_of(CAPTURES / "mks_can.asc", tmp_path)
    assert "0x001" in {drive.who for drive in traffic.drives.values()}
    assert traffic.breaches["unknown_choice"].first[0].raw.startswith("001 ")


def test_values_of_other_devices_are_kept_with_their_units(tmp_path):
    devices = CAPTURES / "devices"
    battery = traffic_of(devices / "battery.log", tmp_path, "--dbc", str(devices / "battery.dbc")).drives["can0", "291"]
    assert (battery.answers, battery.messages, battery.replies) == (0, 2, 0)
    values = {name: (track.columns()[2].tolist(), battery.units[name]) for name, track in battery.states.items()}
    # Of the multiplexed signals each frame has its own; a mode is no curve.
    assert values == {
        "voltage": ([48, 479 * 0.1], "V"), "current": ([-0.12, -0.16], "A"), "page": ([0, 1], ""),
        "cell_temperature": ([25], "degC"), "charge": ([82.5], "%"),
    }  # fmt: skip
    traffic = traffic_of(devices / "meter.log", tmp_path, "--modbus-map", str(devices / "meter.csv"))
    meter = traffic.drives["serial", "5"]
    assert {name: meter.units[name] for name in meter.states} == {"voltage": "V", "power": "W", "energy": "kWh", "relay": ""}
    assert (meter.answers, meter.replies > 0) == (0, True)
    assert traffic.drives["serial", "1"].answers
