"""The memory that columns are made in: what is given back is there for the next ones."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

#: Pieces of 4 MiB, one after the other. Each page that the system gives is a fault.
_PIECES = """
import resource, sys
import numpy as np
from analyzer.columns.memory import keep
if sys.argv[1] == "keep":
    keep()
np.ones(1 << 22, np.uint8)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    np.ones(1 << 22, np.uint8)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
_ONE = (1 << 22) // 4096


def _faults(how: str) -> int:
    told = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536", "GLIBC_TUNABLES": ""}
    # Huge pages make few faults of many pages.
    told["NUMPY_MADVISE_HUGEPAGE"] = "0"
    done = subprocess.run([sys.executable, "-c", _PIECES, how], env=told, check=True, capture_output=True, text=True)
    return int(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the C library is another")
def test_memory_is_kept_where_dask_has_told_the_c_library_to_keep_little() -> None:
    assert _faults("keep") < _ONE
    assert _faults("give back") > 10 * _ONE
