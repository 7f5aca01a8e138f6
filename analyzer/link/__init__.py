"""Links: how the frames of a dialect are delimited, checked and addressed; one module for each link."""

from __future__ import annotations

from analyzer.link.can import EXTENDED_ID, CanLink, MessageLink
from analyzer.link.guarded import guarded
from analyzer.link.head import HeadLink, Package
from analyzer.link.interface import (
    MORE,
    TIE,
    Candidate,
    Candidates,
    Check,
    CommandShape,
    Finder,
    FormShape,
    Head,
    Link,
    Part,
    Role,
    Slicer,
    places_in,
    sum8,
)
from analyzer.link.lk import LkLink
from analyzer.link.modbus import (
    FUNCTIONS,
    LAST_EXCEPTION,
    LAST_UNIT,
    MOST_REGISTERS,
    READS,
    REGISTER_READS,
    WRITE_MANY,
    WRITE_ONE,
    ModbusLink,
    ModbusSlaveLink,
    modbus_crc,
    read_bytes,
)

__all__ = [
    "EXTENDED_ID",
    "FUNCTIONS",
    "LAST_EXCEPTION",
    "LAST_UNIT",
    "MORE",
    "MOST_REGISTERS",
    "READS",
    "REGISTER_READS",
    "TIE",
    "WRITE_MANY",
    "WRITE_ONE",
    "CanLink",
    "Candidate",
    "Candidates",
    "Check",
    "CommandShape",
    "Finder",
    "FormShape",
    "Head",
    "HeadLink",
    "Link",
    "LkLink",
    "MessageLink",
    "ModbusLink",
    "ModbusSlaveLink",
    "Package",
    "Part",
    "Role",
    "Slicer",
    "guarded",
    "modbus_crc",
    "places_in",
    "read_bytes",
    "sum8",
]
