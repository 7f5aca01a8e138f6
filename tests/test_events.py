"""Events of a recording: each kind has a text from its values alone, and those that matter become findings."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analyzer.events import KINDS, SETUPS, cuts, issue_of, span_ns, text_of
from analyzer.findings import RULES
from analyzer.records import Event, Severity

NAMES = sorted({*KINDS, "a kind of a later version"})
VALUE_NAMES = ["from", "to", "gap", "reason", "bytes", "frames", "count", "cause", "step", "drift", "what", "stem", "part"]
NUMBERS = frozenset(("gap", "step", "drift"))


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(
    st.sampled_from(NAMES),
    st.dictionaries(st.sampled_from(VALUE_NAMES), st.one_of(st.integers(0, 1 << 40), st.text(max_size=5)), max_size=6),
)
def test_any_event_of_a_log_has_a_text(name, values):
    values = {k: v for k, v in values.items() if k not in NUMBERS or isinstance(v, int)}
    event = Event(5, "a", name, values)
    text_of(event)
    issue = issue_of(event)
    assert issue is None or issue.rule in RULES
    first_ns, last_ns = span_ns(event)
    assert first_ns <= last_ns == 5


def test_every_rule_of_an_event_is_a_rule():
    assert {kind.rule for kind in KINDS.values() if kind.rule} <= RULES.keys()
    assert KINDS.keys() >= SETUPS


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("dropped", {"bytes": 1, "reason": "disk full"}, "1 byte received but not stored (disk full)"),
        ("dropped", {"frames": 2, "from": "A", "to": "B"}, "2 frames received but not stored, from A to B"),
        ("missing", {}, "an unknown amount missing in the stored data"),
        ("overrun", {"overrun": 3, "parity": 1}, "3 overruns of the hardware's buffer, 1 parity error"),
        ("back", {"gap": 1.5, "from": "12:00"}, "gone for 1.500 s, from 12:00 on"),
        ("bus_error", {"reason": "bus off", "count": 1}, "bus off"),
    ],
)
def test_texts(name, values, text):
    assert text_of(Event(0, "a", name, values)) == text


def test_bus_off_is_an_error_and_other_troubles_of_a_bus_are_warnings():
    assert issue_of(Event(0, "a", "bus_error", {"reason": "Bus off"})).severity is Severity.ERROR
    assert issue_of(Event(0, "a", "bus_error", {"reason": "error passive"})).severity is None


def test_what_cuts_and_what_does_not():
    assert all(cuts(Event(0, "a", name)) for name in ("lost", "back", "dropped", "missing", "damaged", "fault"))
    assert not any(cuts(Event(0, "a", name)) for name in ("open", "note", "mark", "clock_step", "restarted"))


def test_a_gap_is_the_span_of_its_finding():
    assert span_ns(Event(9_000_000_000, "a", "back", {"gap": 2.0})) == (7_000_000_000, 9_000_000_000)
