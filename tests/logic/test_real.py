"""Real captures: what is found by itself is what sigrok-cli reads when it is told everything."""

from __future__ import annotations

import re

import pytest

from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources import open_source
from tests import CAPTURES
from tests.contracts.source_contract import read_all

CAPTURES = CAPTURES / "logic"
#: Samples a second, and nanoseconds of all bits behind the data of a byte.
RATES = {
    "ampel64_4800_8n1_frame_errors": (2_000_000, 1 / 4800),
    "flowmeter_graph_tool": (4_000_000, 1 / 9600),
    "glitch_0x43": (2_000_000, 1 / 115200),
    "hello_world_7e1_115200": (1_000_000, 2 / 115200),
    "hello_world_8n1_19200": (1_000_000, 1 / 19200),
}
CAN = "mcp2515dm-bm-125kbits_bus_load_25percent"


def golden(name: str) -> list[str]:
    return [line for line in (CAPTURES / f"{name}.golden").read_text().splitlines() if not line.startswith("#")]


def test_every_capture_is_tried() -> None:
    assert {path.stem for path in CAPTURES.glob("*.sr")} == {*RATES, CAN}


@pytest.mark.parametrize("name", RATES)
def test_bytes_of_real_captures(name: str) -> None:
    rate, behind_s = RATES[name]
    source, records = read_all(CAPTURES / f"{name}.sr")
    found = [record for record in records if isinstance(record, Chunk)]
    rows = [re.fullmatch(r"\d+-(\d+) uart-1: ([0-9A-F]{2})", line) for line in golden(name)]
    assert [chunk.data.hex().upper() for chunk in found] == [row[2] for row in rows if row]
    for chunk, row in zip(found, rows, strict=True):
        assert row is not None
        assert chunk.t_ns is not None
        # sigrok ends the data on a sample; glitches and clocks that are off move either by some.
        assert abs(chunk.t_ns / 1e9 - int(row[1]) / rate - behind_s) < 0.1 * behind_s + 3 / rate
    bad = sum(sum(record.values.values()) for record in records if isinstance(record, Event))
    assert bad == 3 * (name == "ampel64_4800_8n1_frame_errors")
    assert source.problems == []


def test_frames_of_a_real_capture() -> None:
    with open_source(CAPTURES / f"{CAN}.sr") as source:
        found = [record for record in source if isinstance(record, CanFrame)]
        assert source.kind == "can"
    frames: list[tuple[int, str, bytes]] = []
    number, data = 0, b""
    for line in golden(CAN):
        row = re.fullmatch(r"\d+-(\d+) can-1: (.*)", line)
        assert row is not None
        if found_id := re.search(r"Identifier: \d+ \(0x([0-9a-f]+)\)", row[2]):
            number = int(found_id[1], 16)
        elif row[2].startswith("Data byte"):
            data += bytes.fromhex(row[2][-2:])
        elif row[2] == "End of frame":
            frames.append(((int(row[1]) + 1) * 250, number, data))
            data = b""
    assert [(f.id, f.data) for f in found] == [(number, data) for _, number, data in frames]
    assert not any(f.error for f in found)
    assert all(abs((f.t_ns or 0) - t_ns) <= 500 for f, (t_ns, _, _) in zip(found, frames, strict=True))
