"""The memory that columns are made in."""

from __future__ import annotations

import numpy as np

#: Bytes of a piece of memory, less what the C library writes beside it.
_SIGN = (8 << 20) - (8 << 10)


def keep() -> None:
    """Have memory that is given back kept for the next columns, up to 16 MiB: the system gives and clears each page anew.

    The C library of Linux keeps twice as much as the largest piece that was given back. This one is never touched.
    """
    np.empty(_SIGN, dtype=np.uint8)
