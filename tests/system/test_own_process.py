"""Other libraries import nothing extra in the program's own process; in a process of another program they may."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests import CAPTURES

LOAD = (
    "import sys; from importlib.util import find_spec; from analyzer.system import own_process; own_process.is_own = {}; "
    "from analyzer.sources import open_source; list(open_source(sys.argv[1])); from can.io import mf4; "
    "print('asammdf' in sys.modules, mf4.asammdf is not None, find_spec('asammdf') is not None)"
)
DECODE = "import sys; from analyzer.__main__ import main; main(); print(*(name in sys.modules for name in ('{}', '{}')))"


def out_of(code: str, *words: str) -> list[str]:
    """Return the words of the last line that a program prints."""
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()[-1].split()


@pytest.mark.parametrize("own", [True, False])
def test_asammdf_is_loaded_in_a_process_of_someone_else_alone(own):
    pytest.importorskip("asammdf")
    assert out_of(LOAD.format(own), str(CAPTURES / "mks_can.asc")) == [str(not own), str(not own), "True"]


@pytest.mark.parametrize("name", ["mks_can.asc", "mks_can.csv"])
def test_the_command_line_decodes_without_it(name, tmp_path):
    words = "decode", str(CAPTURES / name), "-o", str(tmp_path / "out.mcap")
    assert out_of(DECODE.format("can", "asammdf"), *words) == ["True", "False"]


def test_tables_are_written_without_pandas(tmp_path):
    pytest.importorskip("pyarrow")
    words = "decode", str(CAPTURES / "mks_can.log"), "--to", "parquet", "-o", str(tmp_path / "out.parquet")
    assert out_of(DECODE.format("pyarrow", "pandas"), *words) == ["True", "False"]
