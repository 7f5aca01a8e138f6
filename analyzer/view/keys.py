"""The keys: one table, from which the bindings, the foot and the help are made."""

from __future__ import annotations

from typing import NamedTuple

from textual.binding import Binding


class Key(NamedTuple):
    """A key: what it does, what the foot calls it (nothing: not in the foot), what the help says."""

    key: str
    action: str
    foot: str
    help: str
    live_only: bool = False


KEYS = (
    Key("1", "panel('frames')", "Frames", "frames as they come, decoded"),
    Key("2", "panel('counts')", "Counts", "every command of every address: requests, replies, rate, latency"),
    Key("3", "panel('findings')", "Findings", "errors, warnings and notes; Enter jumps to the frame"),
    Key("4", "panel('plot')", "Plot", "selected fields over time; Enter adds or removes a field"),
    Key("enter", "details", "Bytes", "show or hide the frame under the cursor byte by byte; [ and ] scroll"),
    Key("f", "filter", "Filter", 'show only matching frames: address == 1 and "bad_checksum" in findings'),
    Key("slash", "search", "Search", "search fields, names and hex; n and N go to the next and the previous match"),
    Key("e", "finding(1)", "Next!", "the next frame with a finding; E the previous one"),
    Key("space", "pause", "Pause", "freeze the frames; counts and log continue", True),
    Key("m", "mark", "Mark", "write a note into the log, at the current time", True),
    Key("x", "shows", "", "fields, bytes, or both"),
    Key("t", "time", "", "time of day, seconds since the first frame, or since the line above"),
    Key("o", "order", "", "sort the counts by address, count, rate or latency"),
    Key("plus,equals_sign", "zoom(1)", "", "plot a shorter time range; - a longer one"),
    Key("minus", "zoom(-1)", "", ""),
    Key("n", "again(1)", "", ""),
    Key("N", "again(-1)", "", ""),
    Key("E", "finding(-1)", "", ""),
    Key("left_square_bracket", "scroll_details(-1)", "", ""),
    Key("right_square_bracket", "scroll_details(1)", "", ""),
    Key("escape", "step_back", "", "no filter, no search, no details"),
    Key("question_mark,h,f1", "keys", "Help", "this page"),
    Key("q", "leave", "Quit", "quit; while recording this ends the recording, after a question"),
    Key("ctrl+c", "stop", "", "end at once"),
)
_NAMES = {
    "slash": "/", "plus,equals_sign": "+", "minus": "-", "question_mark,h,f1": "?", "space": "Space", "enter": "Enter",
    "escape": "Esc", "ctrl+c": "Ctrl-C",
}  # fmt: skip
_MOVING = (
    ("arrows j k", "one row up or down"),
    ("PgUp PgDn", "a page"),
    ("Home End g G", "the first, the last; at the last the view follows new frames"),
    ("← →", "in the plot: a cursor that reads out; with Shift by ten columns, Esc takes it away"),
)


def bindings(live: bool) -> list[Binding]:
    """Return the bindings. Ctrl-C works wherever the cursor is."""
    return [
        Binding(
            key.key,
            key.action,
            key.foot or key.help,
            show=bool(key.foot),
            key_display=_NAMES.get(key.key),
            priority=key.key == "ctrl+c",
        )
        for key in KEYS
        if live or not key.live_only
    ]


def help_text(live: bool) -> str:
    """Return what the keys do, a line each."""
    rows = list(_MOVING)
    for key in KEYS:
        if key.help:
            note = "" if live or not key.live_only else "  (only while recording)"
            rows.append((_NAMES.get(key.key, key.key), key.help + note))
    signs = (
        "signs: > request  < reply  ? unknown sender  ~ junk  * event;  E error  W warning  i info\n"
        "times are in the zone that stands above them; 'not shown' counts frames too fast for the display: they are in the log"
    )
    return "\n".join(f"{name:>13}  {text}" for name, text in rows) + "\n\n" + signs
