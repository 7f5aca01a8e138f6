"""Targets that read a file about other devices, damaged: DBC, KCD and lists of Modbus registers."""

from __future__ import annotations

import csv
import signal
from unittest import mock

from analyzer.devices import dbc, dbc_child
from analyzer.devices.dbc_child import MessageFacts
from analyzer.devices.text import Text
from tests.fuzz.corpus import INPUT, Input, lay_out
from tests.fuzz.running import Fault, Place, check_log, fed, run_words
from tests.fuzz.seeds import DEVICES

#: Files of devices, each with the option that takes it and a capture of such devices.
_MAP, _DBC = ("in.csv", "--modbus-map", "meter.log"), ("in.dbc", "--dbc", "battery.log")


def _parsed_here(path: str, data: bytes, format: str) -> list[MessageFacts]:
    """Parse a file of messages in this process, which has bounds, too: a process for each takes thirty times as long."""

    def late(number: int, frame: object) -> None:
        raise MemoryError("too late")

    text, before = Text(path, data), signal.signal(signal.SIGVTALRM, late)
    signal.setitimer(signal.ITIMER_VIRTUAL, 4.0)
    try:
        return dbc_child.parsed(text, format)
    except (MemoryError, dbc_child.TooMuchError):
        raise text.error("reading it takes more memory or time than a device file may") from None
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


def _run(given: Input, place: Place, *words: str) -> int:
    """Run a command on a capture of the devices that a file describes, and return its status."""
    data = given[INPUT]
    name, option, capture = _MAP if b"unit" in data[:300] else ("in.kcd", *_DBC[1:]) if data[:1] == b"<" else _DBC
    lay_out({name: data, INPUT: (DEVICES / capture).read_bytes()}, place.folder)
    with mock.patch.object(dbc, "_parsed", _parsed_here):
        return run_words((*words, INPUT, option, name), place)


def decoded(given: Input, place: Place) -> None:
    """Decode; a log is whole, or absent where the file is refused."""
    status = _run(given, place, "decode", "-o", "out.mcap")
    if status == 0:
        check_log(place.folder / "out.mcap", fed(place.folder / INPUT))
    elif (place.folder / "out.mcap").exists():
        raise Fault("a log was written, and its device file was refused")


def tabled(given: Input, place: Place) -> None:
    """Export as CSV and as Parquet: both have the same frames, or neither is written."""
    from pyarrow import parquet

    text, binary = place.folder / "out.csv", place.folder / "out.parquet"
    statuses = {_run(given, place, "export", "-o", each.name) for each in (text, binary)}
    if len(statuses) > 1 or {text.exists(), binary.exists()} != {0 in statuses}:
        raise Fault(f"one kind of table was written, another was not: {statuses}")
    if 0 in statuses:
        with text.open(encoding="utf-8", newline="") as file:
            rows = [(row["raw"], row["offset"], row["command"]) for row in csv.DictReader(file)]
        table = parquet.read_table(binary, columns=["raw", "offset", "command"]).to_pylist()
        if rows != [tuple("" if value is None else str(value) for value in row.values()) for row in table]:
            raise Fault("the tables have other frames: CSV and Parquet differ")
