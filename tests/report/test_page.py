"""The page of a log: what it says, how large it is, that hostile text stays text, and how a browser draws it."""

from __future__ import annotations

import base64
import json
import re

import matplotlib.image
import numpy as np
import pytest
from mcap.writer import Writer

from analyzer.cli import main
from analyzer.report.page import LARGEST
from tests import CAPTURES
from tests.browser import chromium, needs_chromium
from tests.collect import crc
from tests.conformance.report.test_page import EVIL, told

START = 1_772_442_000_000_000_000


def made(*words):
    """Return the page that the command makes of some files."""
    out = words[-1]
    assert main(["report", *map(str, words[:-1]), "-o", str(out)]) == 0
    return out.read_text()


def charts(page):
    return [json.loads(each) for each in re.findall(r'<div class="plot long".*?json">(.*?)</script>', page, re.DOTALL)]


def values(column):
    """Return what a packed column holds."""
    whole = np.frombuffer(base64.b64decode(column["text"]), "<u4")
    return np.round(column["low"] + whole * (column["high"] - column["low"]) / (2**32 - 2), 6).tolist()


def write_log(path, messages, *, metadata=None, about=None):
    """Write a log of (topic, nanoseconds from the start, fields), in the form of this program's."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="servotap", library="x")
        channels = {}
        for sequence, (topic, t_ns, fields) in enumerate(messages, 1):
            if topic not in channels:
                unit = {"properties": {"speed": {"unit": EVIL if about else "rpm"}}}
                schema = writer.register_schema(f"s{len(channels)}", "jsonschema", json.dumps(unit).encode())
                words = {"dialect": "mks-can", "command": topic.split("/")[-2], "bus_kind": "can", **(about or {})}
                channels[topic] = writer.register_channel(topic, "json", schema, words)
            writer.add_message(channels[topic], START + t_ns, json.dumps(fields).encode(), START + t_ns, sequence)
        writer.add_metadata("servotap", metadata or {"time_source": "capture", "format": "x"})
        writer.finish()


def test_a_page_says_what_was_captured_and_what_is_wrong(tmp_path):
    text = told(page := made(CAPTURES / "mks_rs485.log", tmp_path / "x.html"))
    assert "A value is outside the range of the manual: current: got 6000 mA" in text
    assert "Send a value within the range" in text
    assert "frames 39 on 1 bus" in text
    assert "1 × out_of_range error: a value outside the range that the manual gives" in text
    assert "FA 01 83 17 70 05 current=6000 mA" in text
    assert "set_current 2 4.063" in text
    drawn = {each["y"]: each for each in charts(page)}
    assert set(drawn) == {"frames", "findings", "position", "speed"}
    assert drawn["speed"]["axis"] == "clock"
    # Frames by second, with nothing where nothing came: 8 in the first, 12 in the second, then silence.
    assert values(drawn["frames"]["data"][1])[:4] == [8, 12, 0, 5]
    assert drawn["speed"]["data"][1]["low"] == 320
    assert "http" not in re.sub(r"<script>/\*.*?</script>", "", page, flags=re.DOTALL)


def test_neither_a_damaged_address_nor_another_slave_is_a_drive_that_answers(tmp_path):
    rows = ["> " + crc("01 04 00 32 00 01"), "< " + crc("01 04 02 01 40")] * 3
    rows += ["> " + crc("05 04 00 00 00 02"), "< " + crc("05 04 04 00 2A 00 07"), "> " + crc("01 04 00 32 00 01")]
    rows += ["< 02" + crc("01 04 02 01 40")[2:]]
    (tmp_path / "x.txt").write_text("\n".join(rows) + "\n")
    assert "drives that answer 1 mks-modbus" in told(made(tmp_path / "x.txt", tmp_path / "x.html"))


def test_a_log_and_its_capture_give_the_same_page(tmp_path, capsys):
    one = made(CAPTURES / "mks_rs485.log", tmp_path / "a.html")
    assert main(["decode", str(CAPTURES / "mks_rs485.log"), "-o", str(tmp_path / "mks_rs485.log.mcap")]) == 0
    other = made(tmp_path / "mks_rs485.log.mcap", tmp_path / "b.html")
    assert told(one) == told(other).replace("mks_rs485.log.mcap", "mks_rs485.log")


@pytest.mark.parametrize("looked", range(1, 9))
def test_of_a_long_log_a_part_is_diagnosed_and_its_end_is_no_trouble(tmp_path, monkeypatch, looked):
    monkeypatch.setattr("analyzer.cli.report.LOOKED", looked)
    assert main(["decode", str(CAPTURES / "lk_rs485.log"), "-o", str(tmp_path / "x.mcap")]) == 0
    text = told(made(tmp_path / "x.mcap", tmp_path / "x.html"))
    assert "Nothing wrong was found" in text
    assert re.search(r"The diagnosis looked at \d frames from its beginning on", text)


def test_a_capture_without_times_counts_frames(tmp_path):
    text = told(page := made(CAPTURES / "mks_rs485.bin", tmp_path / "x.html"))
    assert "The capture has no times: plots count its frames" in text
    assert "median latency" not in text
    assert {each["axis"] for each in charts(page)} == {"frames"}


def test_a_capture_with_nothing_to_decode_is_a_page_that_says_so(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(bytes(range(1, 250)) * 9)
    assert main(["report", str(path)]) == 0
    assert "cause" in told((tmp_path / "x.bin.html").read_text())


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04broken"])
def test_of_a_capture_that_cannot_be_read_there_is_no_page(tmp_path, data, cli):
    path = tmp_path / "x.sr"
    path.write_bytes(data)
    assert cli("report", path, status=2).err.count("\n") == 1
    assert [each.name for each in tmp_path.iterdir()] == ["x.sr"]


def test_a_comment_without_a_time_does_not_move_the_beginning(tmp_path):
    assert "Times are of 2026-03-02 UTC" in told(made(CAPTURES / "mks_rs485.mcap", tmp_path / "x.html"))


def test_several_captures_stand_on_one_page(tmp_path):
    page = made(CAPTURES / "mks_rs485.log", CAPTURES / "mks_can.asc", CAPTURES / "lk_rs485.log", tmp_path / "x.html")
    assert "3 captures" in told(page)
    assert {each["group"] for each in charts(page)} >= {"log-1", "log-2", "log-3"}
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(ids)


def test_a_file_that_cannot_be_read_stands_beside_the_others(tmp_path, capsys):
    out = tmp_path / "x.html"
    assert main(["report", str(CAPTURES / "mks_rs485.log"), str(tmp_path / "none.log"), "-o", str(out)]) == 2
    text = told(out.read_text())
    assert "2 captures" in text
    assert "none.log: No such file or directory" in text
    assert main(["report", str(tmp_path / "none.log"), "-o", str(tmp_path / "none.html")]) == 2
    assert not (tmp_path / "none.html").exists()


def test_a_log_is_decoded_again_where_that_is_asked_for(tmp_path):
    log = tmp_path / "x.mcap"
    assert main(["decode", str(CAPTURES / "mks_rs485.log"), "-o", str(log)]) == 0
    assert "expected 0..3000 mA" in told(made(log, "--model", "42D", tmp_path / "x.html"))
    part = told(made(log, "--since", "+9.85s", "--until", "+9.95s", tmp_path / "part.html"))
    assert "frames 2 on 1 bus" in part
    assert "bad_checksum" in part
    assert "out_of_range" not in part


def test_a_page_is_replaced_only_by_force_and_never_the_capture(tmp_path, cli):
    capture = tmp_path / "x.html"
    capture.write_text((CAPTURES / "mks_rs485.log").read_text())
    for words, says in (
        (["-o", str(capture)], "is one of the files that are read"),
        (["-o", str(tmp_path)], "is a folder: name a file"),
        ([str(capture)], "name the page with -o OUT.html"),
    ):
        assert says in cli("report", capture, *words, status=2).err
    made(capture, tmp_path / "y.html")
    assert "--force replaces it" in cli("report", capture, "-o", tmp_path / "y.html", status=2).err


def test_long_pauses_part_a_capture_and_break_its_lines(tmp_path):
    hour = 3_600_000_000_000
    states = [("/b/1/state", part * hour + n * 10_000_000, {"speed": float(n)}) for part in (0, 5, 9) for n in range(50)]
    # A second's counts come with the first frame behind it.
    counts = [("/b/stats", at, {"frames": 50}) for at in (5 * hour, 9 * hour, 9 * hour + 500_000_000)]
    reply = ("/b/1/read_speed/reply", 0, {"speed": 1, "_raw": "32"})
    write_log(tmp_path / "x.mcap", sorted([reply, *states, *counts], key=lambda each: each[1]))
    page = made(tmp_path / "x.mcap", tmp_path / "x.html")
    assert len(re.findall(r"<button data-low", page)) == 3
    (speed,) = (each for each in charts(page) if each["y"] == "speed")
    assert page.count('class="plot long"') == 2
    assert len(speed["data"][0]["text"]) == len(speed["data"][1]["text"]) == pytest.approx(152 * 4 * 4 / 3, abs=4)


def test_a_hundred_drives_and_a_thousand_rules_make_a_small_page(tmp_path):
    messages = [
        (f"/b/{drive}/state", n * 1_000_000 + drive, {"speed": n * 1.234567, "position": n * 9.87, "current": 0.1 * n})
        for n in range(60)
        for drive in range(1, 301)
    ]
    long = "x" * 3000
    messages += [
        (
            "/findings",
            60_000_000 + n,
            {"level": 4, "name": f"{n}{long}", "message": long, "file": long, "address": n % 300, "bus": "b"},
        )
        for n in range(1000)
    ]
    messages += [(f"/b/{n}/{long}/reply", 61_000_000 + n, {"_raw": "00", "_latency": 0.001}) for n in range(300)]
    messages += [("/comments", 62_000_000, {"message": long}) for _ in range(300)]
    write_log(tmp_path / "x.mcap", messages)
    page = made(tmp_path / "x.mcap", tmp_path / "x.html")
    assert len(page.encode()) < LARGEST
    assert "of 300 drives with values are drawn" in told(page)


def test_text_from_the_wire_is_text(tmp_path):
    evil = EVIL.replace("/", "|")
    found = {"level": 4, "name": EVIL, "message": EVIL, "file": f"/{evil}/1/run_speed/request", "line": 1, "section": EVIL}
    messages = [
        (f"/{evil}/1/run_speed/request", 0, {"speed": 1, EVIL: EVIL, "_raw": EVIL}),
        (f"/{evil}/{evil}/{evil}/reply", 1, {"_raw": EVIL, "_latency": 0.001, "_request_sequence": 1}),
        (f"/{evil}/1/state", 2, {"speed": 1.0}),
        (f"/{evil}/1/state", 3, {"speed": "no number"}),
        (f"/{evil}/foreign", 4, {"who": EVIL, "length": 1}),
        (f"/{evil}/junk", 5, {"reason": EVIL, "length": 1}),
        (f"/{evil}/unknown", 6, {"address": 1 << 60}),
        ("/findings", 7, {**found, "bus": evil, "address": 1, "offset": 1 << 80}),
        ("/findings", 8, {**found, "bus": evil, "address": 1}),
        ("/comments", 9, {"message": EVIL, "bus": EVIL}),
        ("/recording", 10, {"event": EVIL, "bus": EVIL, "text": EVIL}),
        (f"/{evil}/stats", (1 << 63) - START, {"frames": 1}),
    ]
    names = ("source", "format", "dialect", "dialect_reason", "manual", "time_source", "version", "notes", "source_sha256")
    path = tmp_path / f"{evil}.mcap"
    about = {"dialect": "mks-can", "section": EVIL, "manual": EVIL}
    write_log(path, messages, metadata=dict.fromkeys((*names, "incomplete"), EVIL), about=about)
    page = made(path, tmp_path / "x.html")
    scripts = len(re.findall("<script", page))
    assert "<script>alert" not in page
    assert "<img" not in page
    text = told(page)
    assert "49" not in re.sub(r"[0-9a-f]{8,}", "", text)
    for where in (f"× {EVIL}", f"{evil} · 0x001", f"{EVIL}: {EVIL}", f"manual {EVIL[:20]}", f"format {EVIL}", f"{evil}.mcap"):
        assert where in text, where
    assert EVIL in json.loads(re.search(r'class="marks">(.*?)</script>', page).group(1))[0]["texts"][0]
    assert scripts == len(re.findall("</script>", page))


#: A reader who uses the buttons, drags across the last plot, pulls it with Shift, and clicks twice to see all of it.
READER = """
const told = document.querySelector("output"), over = [...document.querySelectorAll(".u-over")].at(-1);
const press = what => document.querySelector(`[data-do=${what}]`).click();
const mouse = (kind, share, more = {}) => {
  const box = over.getBoundingClientRect();
  const at = { clientX: box.left + share * box.width, clientY: box.top + 20, movementX: 9, bubbles: true, ...more };
  (kind === "mouseup" ? document : over).dispatchEvent(new MouseEvent(kind, at));
};
const rest = () => new Promise(done => setTimeout(done, 50));
const drag = async (from, to, more) => {
  for (const [kind, share] of [["mousemove", from], ["mousedown", from], ["mousemove", to], ["mouseup", to]]) {
    mouse(kind, share, more);
    await rest();
  }
};
over.scrollIntoView();
await rest();
["in", "in", "on"].forEach(press);
document.body.dataset.buttons = told.textContent;
press("all");
await rest();
await drag(0.25, 0.75, {});
document.body.dataset.dragged = told.textContent;
await drag(0.6, 0.5, { shiftKey: true });
document.body.dataset.pulled = told.textContent;
mouse("dblclick", 0.5);
document.body.dataset.all = told.textContent;
"""


@needs_chromium
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_a_browser_draws_it_without_complaint(tmp_path, scheme):
    page = tmp_path / "x.html"
    ramp = [("/b/1/state", n * 10_000_000, {"speed": abs(n % 200 - 100) * 5.0}) for n in range(2000)]
    more = [("/b/1/run_speed/request", 5_000_000_000, {"speed": 1, "_raw": "F6"}), ("/b/stats", 9_000_000_000, {"frames": 9})]
    more += [("/b/stats", 10_000_000_000, {"frames": 7})]
    write_log(tmp_path / "x.mcap", sorted([*ramp, *more], key=lambda each: each[1]))
    made(tmp_path / "x.mcap", page)
    page.write_text(page.read_text().replace("</body>", f"<script>setTimeout(async () => {{ {READER} }}, 300)</script></body>"))
    shot = tmp_path / "x.png"
    dom = chromium(page, tmp_path / "home", "--window-size=1000,1400", "--dump-dom", scheme=scheme)
    assert dom.count("<canvas") == 2
    seen = dict(re.findall(r'data-(\w+)="09:00:(\d\d\.\d)\d* to 09:00:\d\d\.\d+"', dom))
    # 20 s are shown: a quarter of them in the middle, one step on; from 25 % to 75 %; then pulled to the left by 10 %.
    assert {name: float(value) for name, value in seen.items()} == pytest.approx(
        {"buttons": 9.5, "dragged": 5.0, "pulled": 6.0}, abs=0.15
    )
    assert 'data-all=""' in dom
    chromium(page, tmp_path / "home", "--window-size=1000,1400", f"--screenshot={shot}", scheme=scheme)
    seen = np.round(matplotlib.image.imread(shot)[..., :3] * 255).astype(int)
    ground, line = {"light": ((255, 255, 255), (0x0A, 0x7F, 0x7F)), "dark": ((13, 17, 23), (0x39, 0xC5, 0xBB))}[scheme]
    assert (abs(seen - ground).max(axis=2) < 3).mean() > 0.5
    assert (abs(seen - line).max(axis=2) < 30).sum() > 300


#: What a page does when a mouse moves over its plots, at a share of their width.
HOVER = """<script>
setTimeout(() => {
  const over = document.querySelector(".drive .u-over"), box = over.getBoundingClientRect();
  for (const name of ["mouseenter", "mousemove"])
    over.dispatchEvent(new MouseEvent(name, { clientX: box.left + SHARE * box.width, clientY: box.top + 60, bubbles: true }));
}, 1500);
</script>"""


@needs_chromium
def test_values_and_marks_are_told_under_the_cursor(tmp_path):
    page = tmp_path / "x.html"
    made(CAPTURES / "mks_rs485.log", page)
    page.write_text(page.read_text().replace("</body>", HOVER.replace("SHARE", "0.53") + "</body>"))
    dom = chromium(page, tmp_path / "home", "--dump-dom")
    assert re.search(r'class="told">.*?<span>09:00:05\.300  move_relative_pulses direction=cw speed=320 rpm', dom)
    legends = [re.sub(r"<[^>]+>", " ", each) for each in re.findall(r'<table class="u-legend.*?</table>', dom, re.DOTALL)]
    shown = " | ".join(" ".join(each.split()) for each in legends)
    # All plots of a capture tell the values of one time.
    assert "time 09:00:05.000 frames 5 1/s" in shown
    assert "time 09:00:01.143 speed 320 rpm" in shown
