"""One MKS SERVO42D/57D on RS485: a drive that speaks its native frames or Modbus-RTU, as its setting `modbus` says.

    native 8E 01, or `modbus=1` at the start  ->  Modbus     Modbus 008Eh = 0, or a restore  ->  native

Rules kept here:
- Settings, motion and all else are of the drive, not of its dialect; `MksDrive.dialect` is the one it speaks now.
- The reply to a change of dialect is still in the old one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from analyzer.catalogue import Dialect
from analyzer.protocols import mks_modbus, mks_rs485
from conformance.drives.drive import Fault, Quirk
from conformance.drives.mks.drive import MksDrive
from conformance.drives.mks.modbus import ModbusSpeaker
from conformance.drives.mks.rs485 import NativeSpeaker


class MksSerialDrive(MksDrive):
    """One MKS drive on RS485. `dialect`: the one that it speaks at first; see `MksDrive`."""

    def __init__(
        self,
        dialect: Dialect = mks_rs485.DIALECT,
        address: int = 1,
        *,
        model: str = "",
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        seed: int = 0,
    ) -> None:
        model = model or dialect.model
        native, modbus = mks_rs485.DIALECT, mks_modbus.DIALECT
        if model:
            native, modbus = native.for_model(model), modbus.for_model(model)
        given = {"modbus": int(dialect.name == modbus.name)} | dict(settings or {})
        super().__init__(
            (NativeSpeaker(native), ModbusSpeaker(modbus)), address, settings=given, quirks=quirks, faults=faults, seed=seed
        )
