"""What got worse is told, and nothing else; text from captures stays text."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.errors import UnreadableError
from analyzer.fleet.ask import Question
from analyzer.fleet.health import QUANTITIES, History, Who, compared, health, html, link
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests.fleet.lakes import candump, ingest

UNANSWERED = QUANTITIES[0]
WHO = Who("press", "can0", 1)


def change(before, now, requests=1000):
    values = np.array([*before, *now], dtype=float)
    days = np.arange(100 - len(values), 100, dtype=float) + 1
    return compared(WHO, UNANSWERED, History(days, values, np.full(len(values), float(requests))), 100)


def test_a_rise_is_told_with_its_numbers():
    found = change([0.1, 0.2, 0.1, 0.3, 0.2, 0.1], [4, 5, 6, 5, 5, 4, 5])
    assert (found.worse, round(found.before, 2), round(found.spread, 2), found.now, found.days) == (True, 0.15, 0.05, 5, (6, 7))
    assert found.deviations > 40


def test_a_fall_is_told_as_better():
    assert not change([5, 5.1, 4.9, 5, 5, 5.2], [0.1] * 7).worse


@pytest.mark.parametrize(
    ("before", "now"),
    [
        ([0, 0, 0, 0, 0, 0], [0, 0, 0, 50, 0, 0, 0]),  # one bad day
        ([0, 9, 1, 8, 0, 9, 2], [9, 8, 9, 7, 9, 8, 9]),  # it was always so restless
        ([0, 0, 0, 0], [9, 9, 9, 9, 9, 9, 9]),  # too few days before
    ],
)
def test_what_is_no_change_is_not_told(before, now):
    assert change(before, now) is None


def test_the_smallest_change_that_matters_is_told():
    assert change([0] * 20, [UNANSWERED.least] * 7, requests=2000).deviations == pytest.approx(4)
    assert change([0] * 20, [0.9 * UNANSWERED.least] * 7, requests=2000) is None


def test_machines_that_fall_silent_and_drives_that_got_worse_are_shown(tmp_path):
    for day in range(1, 25):
        for machine in ("press", "gone") if day < 10 else ("press",):
            path = tmp_path / "in" / machine / f"2026-03-{day:02d}" / "a.log"
            path.parent.mkdir(parents=True)
            lines = []
            for n in range(40):
                second = day * 86_400 + n + (machine == "gone") * 50
                lines.append(f"({second}.000000) can0 001#3233\n")
                if day < 20 or n % 2:
                    lines.append(f"({second}.002000) can0 001#32012C60\n")
            path.write_text("".join(lines))
    made = Lake(Place(str(tmp_path / "lake")), make=True)
    assert ingest(made, tmp_path / "in").new == 33
    found = health(Question(made))
    assert [each["machine"] for each in found.silent] == ["gone"]
    assert found.worse() == ["press"]
    [press] = [row for row in found.drives() if row[0].machine == "press"]
    # Of each drive, its machine's junk.
    assert [cell for cell, _ in press[1]].count("") == 2
    assert press[1][0] == ("50.0", True)
    assert press[1][-1] == ("0", False)
    assert found.drives()[0] == press
    page = html(found)
    assert "1 of 2 machines got worse" in page
    assert '<td>gone</td><td class="n">2026-03-09</td>' in page


def test_a_request_or_two_is_no_change():
    assert change([0] * 20, [1.67] * 7, requests=60) is None
    assert change([0] * 20, [1.67] * 7, requests=600).worse


@given(st.lists(st.floats(0, 100), min_size=21, max_size=28))
def test_days_like_those_before_are_no_change(values):
    assert change(values, [float(np.median(values))] * 7) is None


def test_a_page_shows_text_of_captures_as_text(tmp_path):
    evil = "<script>alert(1)</script>"
    # A name holds no slash.
    evil = evil.replace("/", "")
    for day in (1, 2):
        path = tmp_path / "in" / evil / f"2026-03-0{day}" / f"{evil}.log"
        path.parent.mkdir(parents=True)
        path.write_text(candump(day, 200))
    made = Lake(Place(str(tmp_path / "lake")), make=True)
    ingest(made, tmp_path / "in")
    found = health(Question(made))
    assert found.last == date(2026, 3, 2)
    assert {who.machine for who, _ in found.drives()} == {evil}
    page = html(found)
    assert evil not in page
    assert "&lt;script&gt;alert(1)" in page


def test_a_lake_without_captures_is_told(tmp_path):
    with pytest.raises(UnreadableError, match="no capture that could be read"):
        health(Question(Lake(Place(str(tmp_path / "lake")), make=True)))


def test_links_lead_to_files_and_https_alone(tmp_path):
    (tmp_path / "a b.log").touch()
    assert link(str(tmp_path), "a b.log") == (tmp_path / "a b.log").as_uri()
    assert link("https://plant.example/c/", "a b.log") == "https://plant.example/c/a%20b.log"
    assert link("s3://plant", "a.log") == link("javascript://x", "alert(1)") == ""
