"""The memory that columns are made in."""

from __future__ import annotations

import contextlib
import ctypes
import sys

#: Numbers of glibc's settings, from its malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
#: Bytes of free memory that are kept at least, and of the largest pieces that are made in it.
_KEPT, _LARGEST = 32 << 20, 8 << 20


def keep() -> None:
    """Have memory that is given back kept for the next columns, up to 32 MiB: the system gives and clears each page anew.

    The C library of Linux learns this by itself, but not where something has told it to keep less, as Dask tells its workers.
    """
    if sys.platform != "linux":
        return
    # Other C libraries of Linux do not have it.
    with contextlib.suppress(AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_TRIM_THRESHOLD, _KEPT)
        mallopt(_MMAP_THRESHOLD, _LARGEST)
