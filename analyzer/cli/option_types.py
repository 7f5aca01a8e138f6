"""Types of options that several commands share: each returns the value of a text, and says what was expected of it."""

from __future__ import annotations

import argparse


def positive(text: str) -> int:
    """Return a whole number above 0."""
    value = int(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text}")
    return value


def address(text: str) -> int:
    """Return an address of any dialect."""
    value = int(text, 0)
    if not 0 <= value <= 0x7FF:
        raise argparse.ArgumentTypeError(f"expected an address 0..0x7FF, got {text}")
    return value


def milliseconds(text: str) -> float:
    """Return milliseconds above 0."""
    value = float(text)
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"expected milliseconds above 0, got {text}")
    return value
