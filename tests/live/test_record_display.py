"""What the displays of a recording print, without processes."""

from __future__ import annotations

import io
import json
import sys

from analyzer.cli.record_display import JsonDisplay, LineDisplay


class Writes(io.StringIO):
    """Standard output that keeps each write: between two of them another thread can write."""

    def __init__(self):
        super().__init__()
        self.each = []

    def write(self, text):
        if text:
            self.each.append(text)
        return len(text)


def test_a_line_is_one_write_so_that_two_threads_never_share_a_line(monkeypatch):
    out, errors = Writes(), Writes()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", errors)
    JsonDisplay().note("left", "cannot store")
    LineDisplay().note("left", "cannot store")
    assert [json.loads(text) for text in out.each] == [{"event": "note", "bus": "left", "text": "cannot store"}]
    assert out.each[0].endswith("}\n")
    assert errors.each == ["left: cannot store\n"]
