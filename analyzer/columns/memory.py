"""The memory that columns are made in."""

from __future__ import annotations

import numpy as np

#: Bytes of the largest piece of memory whose return the C library of Linux takes for a sign, with its own notes on it.
_SIGN = (32 << 20) - (8 << 10)


def keep() -> None:
    """Have memory that is given back kept for the next columns, up to 64 MiB: the system gives and clears each page anew.

    The C library of Linux keeps twice as much as the largest piece that was given back. This one is never touched.
    """
    np.empty(_SIGN, dtype=np.uint8)
