"""Any bytes, read as any format, raise only errors of this program."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from analyzer.errors import ServotapError
from analyzer.sources import FORMATS, open_source
from analyzer.sources.hexline import bytes_of, take_apart
from analyzer.sources.times import number_ns
from tests.contracts.source_contract import check_record
from tests.sources import builders

#: asammdf takes long to load, and is tested on its own.
QUICK = [name for name in FORMATS if name != "mf4"]
quick = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
few = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@cache
def sample(name: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        if name == "mf4":
            return builders.by_python_can(Path(folder) / "x.mf4", builders.messages(8)).read_bytes()
        return builders.SAMPLES[name].make(Path(folder)).read_bytes()


def survive(data: bytes, format: str | None) -> None:
    with tempfile.NamedTemporaryFile(suffix=".mf4") as file:
        file.write(data)
        file.flush()
        try:
            with open_source(file.name, format=format, baud=115200) as source:
                for record in source:
                    check_record(record)
                assert all(isinstance(note, str) for note in source.notes)
        except ServotapError:
            pass


TEXTS = st.text(st.sampled_from("0123456789ABCDEFabcdef xX:;,.-<>[]()#'\"\\\t\n\r TXRXsendcan0[]{}/*=+|\x1b"), max_size=400)


@quick
@given(data=st.binary(max_size=600), name=st.sampled_from([None, *QUICK]))
def test_any_bytes(data: bytes, name: str | None) -> None:
    survive(data, name)


@quick
@given(text=TEXTS, name=st.sampled_from([None, *QUICK]))
def test_any_text(text: str, name: str | None) -> None:
    survive(text.encode(), name)


def damaged(data: bytes, edits: list[tuple[int, int, bytes]]) -> bytes:
    for at, count, new in edits:
        place = at % (len(data) + 1)
        data = data[:place] + new + data[place + count :]
    return data


EDITS = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 40), st.binary(max_size=12)), min_size=1, max_size=6)


@pytest.mark.parametrize("name", builders.SAMPLES)
@few
@given(edits=EDITS)
# In a report of the bus's state: a frame of one byte, with the comma behind it.
@example(edits=[(51, 10, b"0,")])
def test_damaged_captures(name: str, edits: list[tuple[int, int, bytes]]) -> None:
    survive(damaged(sample(name), edits), builders.SAMPLES[name].format)


@settings(max_examples=3, deadline=None)
@given(edits=EDITS)
def test_damaged_mf4(edits: list[tuple[int, int, bytes]]) -> None:
    survive(damaged(sample("mf4"), edits), "mf4")


@quick
@given(text=TEXTS)
def test_any_line_can_be_taken_apart(text: str) -> None:
    for line in text.split("\n"):
        take_apart(line)
        bytes_of(line)


@given(data=st.binary(min_size=1, max_size=60), upper=st.booleans(), separator=st.sampled_from([" ", "", ",", ", ", ":", "-"]))
def test_bytes_survive_being_printed(data: bytes, upper: bool, separator: str) -> None:
    text = separator.join(f"{b:02X}" if upper else f"{b:02x}" for b in data)
    if len(data) == 3 and separator == ":":
        return
    assert bytes_of(text) == data
    assert take_apart(f"TX: {text}").data == data


@given(t_ns=st.integers(0, (1 << 63) - 1), digits=st.integers(1, 9))
def test_printed_times_are_exact(t_ns: int, digits: int) -> None:
    assert number_ns(builders.decimal(t_ns, digits)) == t_ns // 10 ** (9 - digits) * 10 ** (9 - digits)
