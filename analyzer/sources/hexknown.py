"""What a hex text has shown: its frames, to know them again where libraries print them twice, and the words before them."""

from __future__ import annotations

import re

from analyzer.catalogue import Role
from analyzer.link import modbus_crc
from analyzer.sources.hexline import bytes_of
from analyzer.sources.prose import Quotation, role_in_text

#: A library's word for a frame that it goes on with, and has printed before; and for what it had read before.
_AGAIN = re.compile(r"\bprocessing\b\W*$", re.IGNORECASE)
_KEPT = re.compile(r"\b(?:old|extra|unexpected)[_ ]data\s*[:=]\s*$", re.IGNORECASE)
#: A word and its colon before bytes; and bytes behind one to the end of the line.
_LABEL_BEFORE = re.compile(r"([^\W\d_]\w*)\s*[:=]\s*$")
_BEHIND_LABEL = re.compile(r"(?<!\w)(?P<label>[^\W\d_]\w*)\s*[:=]\s*(?P<bytes>[\[({]?\s*(?:0[xX])?[0-9A-Fa-f]{1,2}\b.*)$")
#: Characters before bytes that are looked at for such words: with all of a long line, its cost would grow with its square.
_NEAR = 60
#: Frames that are kept, and bytes of the shortest that has a CRC and something in it.
_KNOWN, _LEAST_CHECKED = 1000, 5
#: Bytes of the shorter of two readings that are joined, and of both.
_LEAST_JOINED, _LONGEST_JOINED = 3, 256


def stands_before(pattern: re.Pattern[str], text: str, quoted: Quotation) -> re.Match[str] | None:
    """Return where a pattern that ends with `$` fits what stands directly before bytes in a text."""
    end = quoted.column - 1
    return pattern.search(text, max(0, end - _NEAR), end)


class Known:
    """The frames of a text so far."""

    def __init__(self) -> None:
        self._whole: set[bytes] = set()
        self._parts: set[bytes] = set()
        #: What came from one sender since its last whole frame.
        self._joined: tuple[Role, bytes] = (Role.UNKNOWN, b"")
        self._labels: set[str] = set()

    def __contains__(self, data: bytes) -> bool:
        return data in self._whole

    def has_part(self, data: bytes) -> bool:
        """Say whether bytes were there before: as a frame, as one without its check, or as what it carries."""
        return data in self._whole or data in self._parts

    def add(self, data: bytes, role: Role) -> None:
        """Keep a frame, to know it again, and its parts, which libraries print again; it may come in several reads."""
        if len(self._whole) >= _KNOWN:
            return
        self._whole.add(data)
        joined = self._joined[1] + data if role is self._joined[0] else data
        for whole in (data, joined):
            if len(whole) >= _LEAST_CHECKED and modbus_crc(whole) == 0:
                self._parts |= {whole[1:-2], whole[:-2]}
                joined = b""
        self._joined = role, joined[-_LONGEST_JOINED:]

    def add_label(self, text: str, quoted: Quotation) -> None:
        """Keep the word that stands right before a frame in a text."""
        if (label := stands_before(_LABEL_BEFORE, text, quoted)) is not None:
            self._labels.add(label[1])

    def labelled(self, text: str) -> list[Quotation]:
        """Return bytes behind a word that stood before frames: too few, or without a letter, to be a frame by themselves."""
        found = _BEHIND_LABEL.search(text) if self._labels else None
        data = bytes_of(found["bytes"]) if found is not None and found["label"] in self._labels else None
        if found is None or not data:
            return []
        return [Quotation(found.start("bytes") + 1, data, role_in_text(text[: found.start("bytes")]), len(text))]

    def new_of(self, text: str, said: list[Quotation]) -> list[Quotation]:
        """Return the frames of a line that it does not repeat, as they came: what a library had kept stands behind."""
        kept: list[Quotation] = []
        others: list[Quotation] = []
        for each in said:
            if not self._is_told_again(text, each):
                (kept if stands_before(_KEPT, text, each) else others).append(each)
        role = others[0].role if others else Role.UNKNOWN
        return [each._replace(role=role) for each in kept if each.data not in self._whole] + others

    def _is_told_again(self, text: str, each: Quotation) -> bool:
        """Say whether a line repeats bytes: with a library's word for that, as parts of a frame, or as two joined readings."""
        again = each.data in self._whole and stands_before(_AGAIN, text, each) is not None
        return again or each.data in self._parts or self._is_joined(each.data)

    def _is_joined(self, data: bytes) -> bool:
        """Say whether bytes are two readings of before, joined by the library that printed them."""
        halves = ((data[:at], data[at:]) for at in range(_LEAST_JOINED, min(len(data) - 2, _LONGEST_JOINED)))
        return data not in self._whole and any(one in self._whole and other in self._whole for one, other in halves)
