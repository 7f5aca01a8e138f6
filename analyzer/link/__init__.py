"""Links: how the frames of a dialect are delimited, checked and addressed; one module for each link."""

from __future__ import annotations

from analyzer.link.can import CanLink
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
    sum8,
)
from analyzer.link.lk import LkLink
from analyzer.link.modbus import FUNCTIONS, READS, WRITE_MANY, WRITE_ONE, ModbusLink, modbus_crc

__all__ = [
    "FUNCTIONS",
    "MORE",
    "READS",
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
    "ModbusLink",
    "Package",
    "Part",
    "Role",
    "Slicer",
    "guarded",
    "modbus_crc",
    "sum8",
]
