"""The text of a device file, and errors that name a place in it."""

from __future__ import annotations

import codecs
import re
from functools import cached_property

from analyzer.errors import UnreadableError
from analyzer.values import printable

#: A larger file is none that people or their tools write for one bus.
MOST_BYTES = 4 << 20
#: How text of 16 bits a character begins.
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
#: Characters of a message of another library that are shown.
_LONGEST = 200


class Text:
    """A file as it was read. Raises UnreadableError for one that is too large, or no text."""

    def __init__(self, path: str, data: bytes) -> None:
        self.path = path
        self.data = data
        if len(data) > MOST_BYTES:
            raise UnreadableError(f"{path}: expected at most {MOST_BYTES >> 20} MiB, got more")
        if b"\0" in data and not data.startswith(_UTF16):
            raise UnreadableError(f"{path}: expected text, got a zero byte at {data.index(0)}")

    @cached_property
    def text(self) -> str:
        """The text: UTF-8, or UTF-16 as Excel writes "Unicode text"; anything else is taken for Windows-1252."""
        if self.data.startswith(_UTF16):
            return self.data.decode("utf-16", "replace")
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError:
            return self.data.decode("cp1252", "replace")

    def error(self, said: str, line: int | None = None) -> UnreadableError:
        """Return an error at a line, counted from 1; None: of the file as a whole."""
        words = printable(" ".join(said.split()))
        cut = words if len(words) <= _LONGEST else words[:_LONGEST] + " ..."
        return UnreadableError(f"{self.path}{'' if line is None else f':{line}'}: {cut}")

    def line_of(self, pattern: str) -> int | None:
        """Return the line in which a pattern is found first."""
        found = re.search(pattern, self.text, re.MULTILINE)
        return None if found is None else self.text.count("\n", 0, found.start()) + 1
