"""The page of a run: what it says, that its links lead somewhere, that hostile text stays text, and how a browser draws it."""

from __future__ import annotations

import json
import re
from html import unescape

import msgspec
import pytest

from conformance.claim import Curve
from conformance.report.html import causes, html, write_html
from conformance.suite.plan import Plan, run
from conformance.suite.record import RunRecord, VerdictRecord
from conformance.suite.target import parse
from tests.browser import chromium, needs_chromium

RUN = RunRecord(targets=("mks-rs485@1",), on=("emulated",), version="1", started_at="2026-03-02T09:00:00Z")
MS = 1_000_000
EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(1)>{{ 7*7 }}&amp;'\""


def verdict(claim: str = "shape/read_speed/answered", outcome: str = "confirmed", **more) -> VerdictRecord:
    theme, command = claim.split("/")[:2]
    about = {
        "id": f"mks-rs485/{claim}", "target": "mks-rs485@1", "theme": theme, "dialect": "mks-rs485", "outcome": outcome,
        "statement": f"{command} is answered.", "section": "5.1.3", "certainty": "certain", "refuted_by": "silence",
    }  # fmt: skip
    return VerdictRecord(**about | more)


def silent(command: str, **more) -> VerdictRecord:
    key = f"the example of {command} is not answered"
    return verdict(f"shape/{command}/answered", "refuted", got="silence", key=key, reason=key, asked=command, **more)


def told(text: str) -> str:
    """Return what a page says, without its scripts, styles and tags."""
    text = re.sub(r"<(script|style)\b.*?</\1>", "", text, flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", text)).split())


def test_the_banner_counts():
    records = [*(silent("read_speed") for _ in range(3)), verdict(), *(verdict(outcome="not run") for _ in range(1103))]
    text = told(html(records, RUN))
    assert "Failed: 3 of 1,107, 1,103 not run" in text
    assert "Passed: 1 of 1, none failed" in told(html([verdict()], RUN))
    assert "No claim was judged: 0 of 1, 1 not run" in told(html([verdict(outcome="not run")], RUN))


def test_the_banner_says_what_broke_a_run_off():
    run = msgspec.structs.replace(RUN, notes=("mks-rs485@1: not seen standing",))
    page = html([verdict()], run)
    assert "Broken off, passed: 1 of 1" in told(page)
    assert "not seen standing" in told(page)
    assert 'class="banner doubt"' in page
    assert 'class="banner bad"' in html([silent("read_speed")], run)


def test_one_cause_is_one_card_with_the_claims_that_it_took():
    records = [
        silent("read_speed"),
        silent("read_io"),
        verdict("shape/read_pulses/answered", "refuted", got="nothing", key="no answer"),
    ]
    records += [
        verdict("motion/run_speed/x", "refuted", got="10 rpm", key="run_speed is slow", reason="run_speed is slow by 3 rpm")
    ]
    found = causes([*records, verdict()])
    assert [(cause.text, len(cause.records)) for cause in found] == [("no answer", 3), ("run_speed is slow by 3 rpm", 1)]
    page = html(records, RUN)
    assert re.findall(r'<article class="card" id="(.*?)">', page) == ["cause-1", "cause-2"]
    assert re.findall(r'<td class="bad"><a href="#(.*?)">failed', page) == ["cause-1"] * 3 + ["cause-2"]
    assert "3 claims failed by this" in told(page)
    # Silence where it was expected is no cause of this kind.
    assert causes([verdict(outcome="refuted", got="silence", expected="silence", key="x")])[0].text == "x"


def test_every_link_leads_somewhere():
    records = [
        silent("read_speed", covers=(("read_speed", "shape"),)),
        verdict(covers=(("read_speed", "shape"), ("read_io", "shape"))),
        verdict(outcome="observed", covers=(("read_io", "shape"),), latencies=(("read_io", MS),)),
        verdict(series={"speed": Curve("rpm", ((0, 0), (1, 5)), ((0, 0), (1, 6)))}),
    ]
    page = html(records, RUN)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    links = re.findall(r'href="#([^"]+)"', page)
    assert {"failed", "verdicts", "coverage", "latency", "ramps", "run", "all", "claims", "claim-1"} <= set(links) <= set(ids)
    marks = [row.split() for row in re.findall(r'data-marks="([^"]*)"', page)]
    for words in re.findall(r'data-find="([^"]*)"', page):
        assert any(set(words.split()) <= set(row) for row in marks), words


def test_coverage_tells_what_did_not_run_from_what_cannot_apply():
    row = re.search(r"<tr><td><code>read_io</code>.*?</tr>", html([verdict(covers=(("read_io", "shape"),))], RUN), re.DOTALL)
    cells = [told(cell) for cell in re.findall(r"<td.*?</td>", row.group(), re.DOTALL)]
    assert cells == ["read_io", "", "✓", "–", "–", "", ""]
    assert "the manual prints none" in html([verdict()], RUN)


def test_latencies_are_listed_where_they_differ():
    alike = [("read_speed", ns * MS) for ns in (3, 3, 4)] + [("read_io", 3 * MS), ("run_speed", 3 * MS)]
    text = told(html([verdict(latencies=(*alike, ("restart", 40 * MS)))], RUN))
    assert "3 commands answer alike: median 3.00 ms, 3.00 to 4.00 ms" in text
    assert "restart 1 40.000 40.000 40.000" in text
    assert "read_io 1" not in text
    assert "No command differs" in told(html([verdict(latencies=tuple(alike))], RUN))


def test_a_ramp_stands_beside_that_of_the_manual():
    (record,) = run(Plan((parse("mks-rs485@1"),), claims=("*/run_speed/ramp-is-even",)))
    curve = record.series["speed"]
    assert curve.unit == "rpm"
    law = dict(curve.expected)
    assert len(curve.points) == 7
    assert all(value == pytest.approx(law[t], abs=8) for t, value in curve.points)
    shown = re.search(r'<script type="application/json">(.*?)</script>', html([record], RUN)).group(1)
    plot = json.loads(shown)
    assert (plot["x"], plot["xUnit"], plot["y"], plot["yUnit"]) == ("time", "s", "speed", "rpm")
    assert [(line["name"], line["dashed"]) for line in plot["lines"]] == [("by the manual", True), ("speed", False)]
    assert len(plot["data"]) == 3
    assert len({len(column) for column in plot["data"]}) == 1


def test_text_from_the_wire_is_text():
    evil = verdict(
        outcome="refuted", reason=EVIL, got=EVIL, expected=EVIL, key=EVIL, lines=(EVIL,), statement=EVIL, firmware=EVIL,
        section=EVIL, measured={EVIL: 1.0}, latencies=((EVIL, MS), ("x", MS), ("y", 9 * MS)),
        series={EVIL: Curve(EVIL, ((0, 0), (1, 5)))},
    )  # fmt: skip
    run = RunRecord(
        targets=(EVIL,), on=(EVIL,), version=EVIL, started_at=EVIL, command=EVIL, notes=(EVIL,), bounds={EVIL: EVIL}
    )
    page = html([evil], run)
    assert "<script>alert" not in page
    assert "<img" not in page
    assert "49" not in told(page)
    assert EVIL in told(page)


def test_a_page_of_all_claims_is_small():
    records = [verdict(f"shape/read_speed/{n}", reason="x" * 60, covers=(("read_speed", "shape"),)) for n in range(6000)]
    assert len(html(records, RUN)) < 3_000_000


@needs_chromium
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_a_browser_draws_it_without_complaint(tmp_path, scheme):
    path = tmp_path / "r.html"
    curve = Curve("rpm", tuple((n / 10, n * 12.0) for n in range(9)), ((0, 0), (1, 120)))
    write_html(path, [silent("read_speed"), verdict(), verdict(series={"speed": curve})], RUN)
    # As a reader who follows the count of failed claims to their rows.
    click = "<script>document.querySelector('[data-find=\"is:failed\"]').click()</script></body>"
    path.write_text(path.read_text().replace("</body>", click))
    page = chromium(path, tmp_path / "home", "--dump-dom", scheme=scheme)
    assert page.count("<canvas") == 1
    assert 'id="find-count">1 of 3<' in page
    assert re.findall(r'<tr id="claim-(\d)"[^>]*hidden', page) == ["2", "3"]
