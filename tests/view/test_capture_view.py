"""The view of a capture, driven by keys; what is checked is what stands on the screen."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import Chunk
from analyzer.sinks.mcap_log import McapLog
from analyzer.sources.tail import Follow
from analyzer.view.capture import CaptureSource
from tests import CAPTURES
from tests.collect import sum8
from tests.view.screen import capture_of, drive, driven, reading_of

START = 1_700_000_000_000_000_000

LOG = CAPTURES / "mks_rs485.log"


def under_cursor(driver):
    return driver.app.frames.line


@driven(LOG)
async def test_frames_are_shown_decoded(driver):
    text = driver.text
    assert "mks_rs485.log  FILE" in text
    assert "39 frames  3 E" in text
    assert re.search(r"09:00:01\.040000 serial    1 > run_speed +direction=ccw speed=320 rpm", text)
    assert re.search(r"09:00:01\.143000 serial    1 < read_speed +speed=320 rpm  \(3\.000 ms\)", text)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (
            "12:00:00.120 -> FA 1 30 2B\n12:00:00.124 -> FB 1 30 0 0 0 1 20 0 4D\n",
            r"12:00:00\.124000 serial +1 < read_encoder_carry",
        ),
        ("If I send FA 01 30 2B nothing comes\n", r"1 > read_encoder_carry"),
        ("ID: 0x01 Data: F6 01 40 02 3A\n", r"can +0x001 > run_speed .*direction=ccw"),
    ],
)
def test_what_was_pasted_is_shown(text, shown, tmp_path):
    (tmp_path / "paste.txt").write_text(text)

    async def steps(driver):
        assert re.search(shown, driver.text), driver.text

    drive(capture_of(tmp_path / "paste.txt"), steps)


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("mks_rs485.*")), ids=lambda p: p.name)
def test_every_format_shows_the_same_commands(path):
    if path.suffix == ".golden":
        pytest.skip("no capture")
    expected = [line.command for line in lines_of(capture_of(LOG)) if line.dialect]
    assert [line.command for line in lines_of(capture_of(path)) if line.dialect] == expected


@pytest.mark.parametrize("name", ["mks_can.candump.log", "lk_rs485.log", "mks_modbus.log"])
def test_every_dialect_is_explained_byte_by_byte(name):
    async def steps(driver):
        for _ in range(6):
            await driver.press("down")
        await driver.press("enter")
        await driver.until(lambda: re.search(r"^offset +hex", driver.text, re.MULTILINE))
        await driver.press("enter")
        assert "offset  hex" not in driver.text

    drive(capture_of(CAPTURES / name), steps, size=(100, 50))


def lines_of(source):
    return [source.lines.line(n) for n in range(source.lines.first, source.lines.stop)]


@driven(LOG)
async def test_moving(driver):
    numbers = []
    for key in ("down", "j", "up", "k", "pagedown", "pageup", "G", "g", "end", "home"):
        await driver.press(key)
        numbers.append(driver.app.frames.cursor)
    last = driver.app.source.lines.stop - 1
    assert numbers == [1, 2, 1, 0, numbers[4], 0, last, 0, last, 0]
    assert 10 < numbers[4] < last


@driven(LOG)
async def test_from_finding_to_finding(driver):
    found = []
    for key in ("e", "e", "e", "e", "E"):
        await driver.press(key)
        found.append(under_cursor(driver).rules[0])
    assert found == ["out_of_range", "failed_status", "bad_checksum", "bad_checksum", "failed_status"]
    assert "a finding: none" not in driver.text
    await driver.press("G", "e")
    assert "a finding: none below" in driver.text


@driven(LOG)
async def test_a_search_goes_through_fields_names_and_bytes(driver):
    await driver.press("slash")
    await driver.type("full_speed")
    assert under_cursor(driver).command == "read_status"
    await driver.press("slash")
    await driver.type("fa01fd")
    assert under_cursor(driver).raw.startswith("FA 01 FD")
    first = driver.app.frames.cursor
    await driver.press("g", "slash")
    await driver.type("1600")
    assert under_cursor(driver).values == {"current": 1600}
    await driver.press("slash")
    await driver.type("MOVE_RELATIVE")
    assert driver.app.frames.cursor == first
    await driver.press("slash")
    await driver.type("MOVE_RELATIVE")
    await driver.press("n")
    assert driver.app.frames.cursor > first
    await driver.press("N", "N")
    assert driver.app.frames.cursor == first
    await driver.press("slash")
    await driver.type("not there")
    assert "'not there': none below" in driver.text


@driven(LOG)
async def test_a_filter_shows_what_it_lets_through_and_says_what_it_does_not_know(driver):
    await driver.press("f")
    await driver.type("speed > 100")
    assert "4 frames shown: speed > 100" in driver.text
    assert [driver.app.frames.lines.line(n).command for n in range(4)] == [
        "run_speed", "read_speed", "move_relative_pulses", "move_relative_axis",
    ]  # fmt: skip
    await driver.press("f")
    await driver.type("spede > 100")
    assert "no field 'spede' in any command; did you mean speed" in driver.text
    assert "filter: spede > 100" in driver.text
    await driver.type("speed > 200")
    assert "frames shown: speed > 200" in driver.text
    await driver.press("f")
    await driver.type("speed > 100")
    await driver.press("f")
    await driver.press("escape")
    assert "4 frames shown" in driver.text
    await driver.press("escape")
    assert "frames shown" not in driver.text
    assert driver.app.frames.wanted is None


@driven(LOG, filter_text='"bad_checksum" in findings')
async def test_a_filter_that_is_given_is_set(driver):
    assert '1 frame shown: "bad_checksum" in findings' in driver.text


@driven(LOG)
async def test_a_jump_to_a_frame_that_the_filter_hides_clears_the_filter(driver):
    await driver.press("f")
    await driver.type("speed > 100")
    await driver.press("3", "down", "enter")
    assert driver.app.shown == "frames"
    assert under_cursor(driver).rules == ("failed_status",)
    assert driver.app.frames.wanted is None


@driven(LOG)
async def test_counts_lead_to_the_frames_of_a_command(driver):
    await driver.press("2")
    text = driver.text
    assert re.search(r"^    set_current +2 +2 +0\.40 +4\.00 +4\.06 +4\.12", text, re.MULTILINE), text
    assert re.search(r"^▾ serial +19 +20 +3\.90\b", text, re.MULTILINE), text
    assert "by address" in text
    await driver.press("o")
    assert "by count" in driver.text
    rows = [row for row in driver.rows if row.startswith("serial ") and "frames/s" not in row]
    assert rows[0].startswith("serial 1: set_current")
    await driver.press("enter")
    assert driver.app.shown == "frames"
    assert "4 frames shown" in driver.text


@driven(LOG)
async def test_findings_are_listed_with_their_counts(driver):
    await driver.press("3")
    text = driver.text
    assert "out_of_range 1  failed_status 1  bad_checksum 1" in text
    assert "(value_out_of_range, likely," in " ".join(text.split())
    assert "E out_of_range: current: got 6000 mA, expected 0..5200 mA (section 5.2.3)" in text
    await driver.press("enter")
    assert under_cursor(driver).command == "set_current"


@driven(LOG)
async def test_fields_are_plotted(driver):
    await driver.press("4")
    await driver.until(lambda: "last 719.648 deg" in driver.text)
    text = driver.text
    assert "deg [1] serial/1 position  last 719.648 deg" in text
    assert re.search(r"^ .* 500┤", text, re.MULTILINE)
    assert re.search(r"UTC 09:00:00 +09:00:05", text)
    assert any(0x2800 < ord(c) < 0x2900 for c in text)
    await driver.press("enter")
    assert "serial/1 position  last" not in driver.text
    for _ in range(3):
        await driver.press("plus")
    assert "plot: 10 s" in driver.text


@driven(LOG, size=(100, 28))
async def test_a_cursor_reads_out_what_was_last_said_until_there(driver):
    await driver.press("4")
    await driver.until(lambda: "last 719.648 deg" in driver.text)
    assert " at 09:00" not in driver.text
    await driver.press("right")
    await driver.until(lambda: "serial/1 speed  320 rpm at 09:00:01.143" in driver.text)
    before = driver.app.plot.cursor_ns
    await driver.press("shift+left")
    await driver.press("left")
    assert driver.app.plot.cursor_ns < before
    for _ in range(12):
        await driver.press("shift+left")
    assert driver.app.plot.cursor_ns == driver.app.source.span()[0]
    assert "speed  nothing yet at the cursor" in driver.text
    await driver.press("escape")
    assert "last 320 rpm" in driver.text


@driven(LOG)
async def test_what_is_read_out_has_room_in_80_columns(driver):
    await driver.press("4", "right")
    await driver.until(lambda: re.search(r"rpm \[2\] speed  320 rpm at 09:00:01\.143$", driver.text, re.MULTILINE))
    assert re.search(r"deg \[1\] (serial/1 )?position  -?[\d.]+ deg$", driver.text, re.MULTILINE)


@driven(LOG, size=(100, 28))
async def test_a_window_is_put_around_the_cursor_and_follows_it(driver):
    await driver.press("4", "right")
    plot = driver.app.plot
    for _ in range(4):
        await driver.press("plus")
    assert "plot: 1 s" in driver.text
    low, high = plot.span()
    assert low <= plot.cursor_ns <= high
    assert high - low == 1_000_000_000
    for _ in range(12):
        await driver.press("shift+right")
    assert plot.span()[0] > low
    assert plot.span()[0] <= plot.cursor_ns <= plot.span()[1]


@driven(LOG, size=(100, 28))
async def test_a_click_on_a_chart_reads_out(driver):
    await driver.press("4")
    await driver.until(lambda: "last 719.648 deg" in driver.text)
    await driver.pilot.click("#chart", offset=(30, 5))
    await driver.settle()
    assert "deg at 09:00:0" in driver.text
    assert any("│" in row.rpartition("┤")[2] for row in driver.rows)


@driven(LOG, size=(110, 50))
async def test_the_fields_stand_below_their_bus_and_drive(driver):
    await driver.press("4")
    assert re.search(r"▾ serial +█?\n.*\n.*\n.*▾ drive 1 ", re.sub(r"(?m)^(.{39}).*$", r"\1", driver.text))
    assert "▸ read_speed reply" in driver.text
    while "read_speed" not in driver.app.plot.rows._rows[driver.app.plot.rows.cursor].path[-1]:
        await driver.press("down")
    await driver.press("enter")
    assert "▾ read_speed reply" in driver.text
    await driver.press("down", "enter")
    await driver.until(lambda: "[3] serial/1 read_speed reply speed  last 320 rpm" in driver.text)
    assert "latency ms" in driver.text
    await driver.press("up", "enter")
    assert "▸ read_speed reply" in driver.text


@driven(LOG)
async def test_a_branch_of_the_counts_closes(driver):
    await driver.press("2")
    assert "read_speed" in driver.text
    await driver.press("enter")
    assert "▸ serial" in driver.text
    assert "read_speed" not in driver.text


@driven(LOG, size=(110, 40))
async def test_a_request_shows_fields_or_nothing_and_the_cursor_row_keeps_its_colours(driver):
    assert re.search(r"> read_speed +[█│]?$", driver.text, re.MULTILINE)
    await driver.press("down")
    strip = driver.app.frames.render_line(2)
    assert not any(segment.style and segment.style.reverse for segment in strip)
    assert all(segment.style.bgcolor for segment in strip if segment.text.strip() not in ("", "█", "│"))


@driven(LOG)
async def test_columns_change(driver):
    await driver.press("x")
    assert re.search(r"> run_speed +FA 01 F6 01 40 02 34", driver.text)
    await driver.press("t")
    assert re.search(r"^ +1\.040000 serial", driver.text, re.MULTILINE)
    await driver.press("t")
    assert re.search(r"^ +\+0\.003000 serial    1 < run_speed", driver.text, re.MULTILINE)


@driven(LOG, size=(140, 30))
async def test_a_wide_terminal_shows_fields_and_bytes(driver):
    assert re.search(r"> run_speed +direction=ccw speed=320 rpm acceleration=2 +FA 01 F6 01 40 02 34", driver.text)


@driven(LOG, size=(110, 40))
async def test_the_help_names_every_key(driver):
    await driver.press("question_mark")
    text = driver.text
    for words in ("Esc", "the next frame with a finding", "only while recording", "Ctrl-C  end at once"):
        assert words in text
    await driver.press("escape")
    assert "Ctrl-C  end at once" not in driver.text


@pytest.mark.parametrize("closed", [False, True], ids=["before the prompt closed", "after it closed"])
def test_enter_pressed_twice_in_the_prompt_counts_once(closed):
    async def steps(driver):
        await driver.press("slash")
        await driver.type("MOVE_RELATIVE")
        first = driver.app.frames.cursor
        await driver.press("g", "slash")
        prompt = driver.app._prompt
        asked = prompt.asking
        prompt.post_message(prompt.Given(asked, "MOVE_RELATIVE"))
        prompt.post_message(prompt.Given("" if closed else asked, "MOVE_RELATIVE"))
        await driver.until(lambda: not prompt.asking)
        await driver.settle()
        assert driver.app.frames.cursor == first

    drive(capture_of(LOG), steps)


@driven(LOG)
async def test_a_file_takes_no_marks(driver):
    await driver.press("m", "space")
    assert not driver.app._prompt.asking
    assert "Mark" not in driver.text


@pytest.mark.parametrize("key", ["q", "ctrl+c", "ctrl+q"])
def test_it_ends(key):
    async def steps(driver):
        await driver.press(key)

    assert drive(capture_of(LOG), steps) == "quit"


@driven(CAPTURES / "mks_rs485.bin")
async def test_a_capture_without_times_says_so_and_makes_up_no_load(driver):
    assert "timestamps estimated from the baud rate" in driver.text
    assert " % " not in driver.rows[1]


@driven(LOG, "--baud", "38400")
async def test_a_given_speed_gives_a_load(driver):
    assert re.search(r"░ +\d+ % average", driver.rows[1])


def test_hostile_text_does_not_steer_the_terminal(tmp_path):
    path = tmp_path / "hostile.log"
    comment = "\x1b]0;owned\x07\x1b[2J [red]markup[/red] \u202e\x9b31m"
    path.write_text(f"# {comment}\n" + LOG.read_text(), encoding="utf-8")

    async def steps(driver):
        svg = driver.app.export_screenshot()
        assert "[red]markup" in driver.text
        for keys in (("enter",), ("down", "enter"), ("2",), ("3",), ("4",)):
            await driver.press(*keys)
            svg += driver.app.export_screenshot()
        assert not set(svg) & set("\x1b\x07\x9b\u202e")

    drive(capture_of(path), steps, size=(160, 30))


def test_a_capture_that_breaks_off_is_shown_as_far_as_it_goes(tmp_path: Path):
    path = tmp_path / "torn.mcap"
    path.write_bytes((CAPTURES / "mks_rs485.mcap").read_bytes()[:-40])

    async def steps(driver):
        assert "39 frames" in driver.text

    drive(capture_of(path), steps)


@pytest.mark.parametrize("size", [(40, 10), (20, 5), (300, 80)])
def test_any_size_of_terminal_will_do(size):
    async def steps(driver):
        for key in ("enter", "2", "3", "4", "1", "f", "escape", "question_mark", "escape"):
            await driver.press(key)

    drive(capture_of(LOG), steps, size=size)


class Growing:
    """A log that is being written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stream = path.open("wb")
        self._log = McapLog(self._stream)
        self._pipeline = Pipeline([dialects.get("mks-rs485")], (self._log,), Options())
        self._count = 0

    def write(self, count: int) -> None:
        for _ in range(count):
            self._count += 1
            chunk = Chunk(START + self._count * 10**7, "left", bytes.fromhex(sum8("FA 01 32")), burst=True)
            self._pipeline.feed(chunk)
        self._pipeline.silence("left")
        self._log.flush()

    def close(self) -> None:
        self._pipeline.close()
        self._log.finish({})
        self._stream.close()


def test_a_log_that_is_written_is_followed(tmp_path):
    log = Growing(tmp_path / "week.mcap")
    log.write(300)
    source = CaptureSource(reading_of(log.path, follow=Follow(lambda path: True)))

    async def steps(driver):
        # The last one is known to be whole when something else comes.
        await driver.until(lambda: "299 frames" in driver.text)
        assert "week.mcap  FOLLOWING" in driver.text
        assert under_cursor(driver).sequence == 299
        log.write(5)
        await driver.until(lambda: under_cursor(driver).sequence == 304)
        log.close()
        await driver.until(lambda: "week.mcap  FILE" in driver.text)

    drive(source, steps)


def test_following_ends_with_the_view(tmp_path):
    log = Growing(tmp_path / "week.mcap")
    log.write(100)
    source = CaptureSource(reading_of(log.path, follow=Follow(lambda path: True)))

    async def steps(driver):
        await driver.until(lambda: "99 frames" in driver.text)
        await driver.press("q")

    assert drive(source, steps) == "quit"
    assert not source._thread.is_alive()
    assert not source._reading.source.notes
    log.close()


def test_a_stretch_of_a_log(tmp_path):
    log = Growing(tmp_path / "week.mcap")
    log.write(3000)
    log.close()
    source = capture_of(log.path, "--since", "+10s", "--until", "+20s")
    lines = lines_of(source)
    assert 990 < len(lines) < 1010
    assert lines[0].sequence > 500
    for number in (0, 1, 500, len(lines) - 1):
        assert source.lines.number_of(lines[number].sequence) == number
    assert source.lines.number_of(lines[-1].sequence + 1) is None
    source.close()


@driven(LOG)
async def test_a_second_enter_in_the_line_at_the_foot_is_passed_over(driver):
    await driver.press("slash")
    line = driver.app.focused
    for _ in range(2):
        line.post_message(line.Submitted(line, "run_speed"))
    # What closes the line may also come before the Enter is dealt with.
    driver.app.screen.query_one("Prompt").close()
    await driver.settle()
    assert "39 frames" in driver.text
