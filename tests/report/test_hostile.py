"""Logs with any JSON in any place: the page and the plot come out, or say in a line why not."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer.cli import main
from tests.report.test_page import write_log

NAMES = (
    "speed", "position", "slots", "_raw", "_latency", "_request_sequence", "_checksum_ok", "_findings", "_can_id", "_offset",
    "address", "who", "length", "reason", "frames", "load", "level", "name", "message", "file", "line", "section", "bus",
)  # fmt: skip
TOPICS = (
    "/b/1/run_speed/request", "/b/1/read_speed/reply", "/b/1/state", "/b/stats", "/b/junk", "/b/unknown", "/b/foreign",
    "/findings", "/comments", "/recording", "/b/99999999999999999999/run_speed/request", "/b/all/long_package/request",
)  # fmt: skip
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats() | st.text(max_size=5) | st.sampled_from(TOPICS)
    | st.sampled_from([10**400, -(1 << 63), 1 << 64]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(NAMES), inner, max_size=3),
    max_leaves=5,
)  # fmt: skip
MESSAGES = st.lists(
    st.tuples(
        st.sampled_from(TOPICS), st.integers(-1_772_442_000, 10**4), st.dictionaries(st.sampled_from(NAMES), VALUES, max_size=5)
    ),
    max_size=12,
)


@settings(max_examples=30)
@given(MESSAGES)
def test_no_log_is_a_fault(messages):
    messages = [(topic, seconds * 1_000_000_000, fields) for topic, seconds, fields in messages]
    with tempfile.TemporaryDirectory() as folder:
        log, page = Path(folder) / "x.mcap", Path(folder) / "x.html"
        write_log(log, [("/b/1/read_speed/reply", 0, {"speed": 1, "_raw": "FB 01 32 00 01 2F", "_offset": 0}), *messages])
        assert main(["report", str(log), "-o", str(page)]) == 0
        assert "</html>" in page.read_text()
        for words in (["speed", "latency"], ["speed", "--filter", 'latency > 1 or "error" in findings or address == 1']):
            assert main(["plot", str(log), *words]) in (0, 2)
