"""Plots of a log: as a picture, and in the terminal."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.figure
import matplotlib.image
import numpy as np
import pytest

from analyzer.cli import main
from analyzer.cli.plot import _drives
from analyzer.report.picture import Panel, draw
from analyzer.report.series import series
from analyzer.sources import open_source
from tests import CAPTURES, ROOT

CAPTURE = str(CAPTURES / "mks_rs485.log")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "x.mcap"
    assert main(["decode", CAPTURE, "-o", str(path)]) == 0
    return path


def values(log, name, **more):
    with open_source(log) as source:
        found, _ = series(source, [name], since_ns=0, until_ns=1 << 63, **more)
    return {each.label: (each.values.tolist(), each.unit) for each in found[name]}


def test_a_quantity_comes_from_the_states_in_one_unit(log):
    assert values(log, "speed") == {"serial/1": ([320], "rpm")}
    assert list(values(log, "position")) == ["serial/1"]


def test_a_field_goes_by_its_command_and_a_latency_is_in_ms(log):
    assert values(log, "read_speed.speed") == {"serial/1/read_speed/reply.speed": ([320], "rpm")}
    assert values(log, "run_speed.acceleration")["serial/1/run_speed/request.acceleration"] == ([2], "")
    assert values(log, "read_speed.latency") == {"serial/1/read_speed/reply.latency": ([3], "ms")}
    # A frame with a wrong checksum gives no values.
    with pytest.raises(Exception, match=r"'read_enabled\.latency' has no values here"):
        values(log, "read_enabled.latency")


def test_a_log_is_decoded_again_with_a_file_of_other_devices(tmp_path, capsys):
    devices, log = CAPTURES / "devices", tmp_path / "x.mcap"
    assert main(["decode", str(devices / "battery.log"), "-o", str(log)]) == 0
    assert main(["plot", str(log), "voltage", "--dbc", str(devices / "battery.dbc")]) == 0
    assert "can0/291/battery_status/message.voltage  47.9 to 48 V" in capsys.readouterr().out
    assert main(["plot", str(log), "voltage"]) == 2
    assert (
        "'voltage' has no values here, there may be current, latency, position, speed, temperature" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["spede"], "no field here is 'spede'; did you mean speed"),
        (["qqq"], "there are acceleration, angle_error, carry"),
        ([], "which field? there are acceleration, angle_error, carry"),
        (["speed", "--drive", "9"], "no such drive here, there are serial/1, serial/2, serial/0, serial/all"),
        (["speed", "--drive", "x"], "--drive: got 'x', expected an address"),
        (["speed", "-o", "x.jpg"], "expected a name that ends in .png, .svg, .pdf"),
        (["speed", "--filter", "address == 2"], "'speed' has no values here"),
        (["speed", "--filter", "spede > 1"], "spede"),
    ],
)  # fmt: skip
def test_what_cannot_be_plotted_is_said_in_a_line(log, words, says, cli):
    told = cli("plot", log, *words, status=2).err
    assert says in told
    assert told.count("\n") == 1


def test_only_what_is_wanted_is_plotted(log, cli):
    assert "serial/1  320 to 320 rpm" in cli("plot", log, "speed", "--filter", 'command == "read_speed" and speed > 300').out
    assert "serial/2/read_io/reply.latency" in cli("plot", log, "latency", "--since", "+9.5s", "--drive", "serial/2").out
    of_can = cli("plot", CAPTURES / "mks_can.candump.log", "latency", "--filter", 'raw == "01 82 01 84"').out
    assert "can0/1/set_work_mode/reply.latency  1 to 1 ms" in of_can
    left = _drives(["left/0x10", "3"])
    assert [left(*each) for each in (("left", "16"), ("right", "16"), ("right", "3"))] == [True, False, True]


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_picture_is_written_once(log, tmp_path, ending, cli):
    out = tmp_path / f"x.{ending}"
    assert main(["plot", str(log), "speed", "position", "-o", str(out)]) == 0
    if ending == "png":
        assert len(np.unique(matplotlib.image.imread(out).reshape(-1, 4), axis=0)) > 20
    assert "exists; --force replaces it" in cli("plot", log, "speed", "-o", out, status=2).err


def test_text_that_no_font_or_formula_takes_is_drawn_as_it_is(tmp_path, cli, recwarn):
    capture = tmp_path / "$\\frac{$ \x1b[31m \u4e2d\ue000.log"
    capture.write_bytes((CAPTURES / "mks_rs485.log").read_bytes())
    assert cli("plot", capture, "speed", "-o", tmp_path / "x.svg").err == ""
    assert not recwarn.list
    figure = matplotlib.figure.Figure()
    (axes,) = draw(figure, [Panel("$x", ["$\\frac{$"], [("$a$", [0.0], [1.0])])], "$$")
    figure.savefig(io.BytesIO())
    assert axes.get_ylabel() == r"\$x [\$\frac{\$]"


@pytest.mark.parametrize("words", [["plot", "PIPE", "speed"], ["report", "PIPE", "-o", "x.html"]], ids=lambda words: words[0])
def test_a_pipe_is_read_once(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("PIPE")
    data = (CAPTURES / "mks_rs485.log").read_bytes()
    with ThreadPoolExecutor(1) as pool:
        wrote = pool.submit(Path("PIPE").write_bytes, data)
        assert main(words) == 0
        assert wrote.result() == len(data)
    assert capsys.readouterr().out


def test_a_capture_without_times_is_plotted_by_its_frames(cli):
    assert "\n   frame 2.0" in cli("plot", CAPTURES / "mks_rs485.bin", "position").out


def test_without_matplotlib_it_says_what_to_install(log):
    code = "import sys; sys.modules['matplotlib'] = None; from analyzer.cli import main; sys.exit(main(sys.argv[1:]))"
    words = [sys.executable, "-c", code, "plot", str(log), "speed", "-o", str(log.with_suffix(".png"))]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "pip install 'servotap[plot]'" in done.stderr
