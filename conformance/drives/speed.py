"""The speed of a drive's link: what its settings say, in bits per second."""

from __future__ import annotations

from collections.abc import Mapping

from analyzer.protocols.mks_can import BIT_RATES
from analyzer.protocols.mks_shared import BAUD_RATES
from conformance.drives.drive import Drive

#: Settings that hold a speed, and what their values mean. A value above all of these is the speed itself.
SPEEDS: Mapping[str, Mapping[int, int]] = {"baud_rate": BAUD_RATES, "bit_rate": BIT_RATES}
_LOWEST = 300
_ANY = 115200


def speed_setting(settings: Mapping[str, int]) -> str | None:
    """Return the name of the setting that holds the speed, None where there is none."""
    return next((name for name in SPEEDS if name in settings), None)


def speed_of(drive: Drive) -> int:
    """Return the bits per second at which a drive listens and sends; its dialect's default where no setting says."""
    settings = drive.settings
    for name, speeds in SPEEDS.items():
        value = settings.get(name)
        if value is not None:
            return speeds.get(value) or (value if value >= _LOWEST else _ANY)
    return drive.dialect.baud_rates[0] if drive.dialect.baud_rates else _ANY
