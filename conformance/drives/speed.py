"""The settings that hold the speed of a drive's link, and the bits per second of their values."""

from __future__ import annotations

from collections.abc import Mapping

from analyzer.protocols.mks_can import BIT_RATES
from analyzer.protocols.mks_shared import BAUD_RATES

SPEEDS: Mapping[str, Mapping[int, int]] = {"baud_rate": BAUD_RATES, "bit_rate": BIT_RATES}
