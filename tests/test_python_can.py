"""python-can comes without asammdf into the program's own process, and whole into one of someone else."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.fuzz.corpus import CAPTURES

LOAD = (
    "import sys; from importlib.util import find_spec; from analyzer import python_can; python_can.own_process = {}; "
    "reader = python_can.load('can.io.asc').ASCReader; from can.io import mf4; "
    "print(reader.__name__, 'asammdf' in sys.modules, mf4.asammdf is not None, find_spec('asammdf') is not None)"
)
DECODE = "import sys; from analyzer.__main__ import main; main(); print('can' in sys.modules, 'asammdf' in sys.modules)"


def out_of(code: str, *words: str) -> list[str]:
    """Return the words of the last line that a program prints."""
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()[-1].split()


@pytest.mark.parametrize("own", [True, False])
def test_asammdf_is_loaded_in_a_process_of_someone_else_alone(own):
    pytest.importorskip("asammdf")
    assert out_of(LOAD.format(own)) == ["ASCReader", str(not own), str(not own), "True"]


@pytest.mark.parametrize("name", ["mks_can.asc", "mks_can.csv"])
def test_the_command_line_decodes_without_it(name, tmp_path):
    assert out_of(DECODE, "decode", str(CAPTURES / name), "-o", str(tmp_path / "out.mcap")) == ["True", "False"]
