"""Pages for the browser, and frames for Wireshark: what must hold of what other programs show."""

from __future__ import annotations

import json
import re
import subprocess
import zlib
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import analyzer
from analyzer import dialects
from analyzer.reference.wireshark import dissector
from tests.fuzz.corpus import INPUT, Input, lay_out
from tests.fuzz.running import Fault, Place, run_words
from tests.reference.beside_wireshark import LINKS, TSHARK
from tests.sources.builders import pcap_file, socketcan

_TEMPLATES = ("page", "report")
#: Elements that have no end, and those whose end may be left out.
_OPEN = frozenset({"meta", "link", "br", "hr", "img", "input", "col", "p", "li", "td", "tr", "th", "dd", "dt"})
#: What Wireshark says of a fault of our dissector. CAN frames that ours leaves to others may be malformed for these.
_OWN_FAULT = re.compile(r"\bLua\b|Malformed Packet: servotap", re.IGNORECASE)
#: Seconds for one capture.
_TSHARK_S = 50
_LINK_USER, _LINK_CAN = 147, 227


@cache
def _own_tags() -> frozenset[str]:
    folders = [Path(analyzer.__file__).parent / name / "templates" for name in _TEMPLATES]
    return frozenset(tag for each in folders for path in each.glob("*.html") for tag in re.findall(r"<(\w+)", path.read_text()))


class _Page(HTMLParser):
    """Reads a page. Raises Fault for an element that no template has, one that does not end, and data that is no JSON."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self._inside: list[str] = []
        self._data = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in _own_tags() or any(name.startswith("on") for name, _ in attrs):
            raise Fault(f"text acts as markup: <{tag} {attrs}>")
        self._data = ("type", "application/json") in attrs
        if tag not in _OPEN:
            self._inside.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _OPEN and self._inside.pop() != tag:
            raise Fault(f"an element ends that was not begun: {tag}")

    def handle_data(self, data: str) -> None:
        if self._data:
            self._data = False
            # Python writes NaN, which JSON does not have.
            json.loads(data, parse_constant=lambda word: 1 / 0)

    def close(self) -> None:
        super().close()
        if self._inside:
            raise Fault(f"the page ends within {self._inside}")


def reported(given: Input, place: Place) -> None:
    """Write a page of a capture; nothing of the capture may act as markup or break the data."""
    lay_out(given, place.folder)
    run_words(("report", INPUT, "-o", "out.html"), place)
    path = place.folder / "out.html"
    if path.exists():
        page = _Page()
        # Python's parser knows the CDATA of a script; SVG and MathML are not in these pages.
        page.feed(path.read_text())
        page.close()


def dissected(given: Input, place: Place) -> None:
    """Show frames in Wireshark; its dissector may not fail in any, and each packet is shown."""
    if TSHARK is None:
        return
    data = given[INPUT]
    chance = zlib.crc32(data)
    size = (8, 3 + chance % 60)[chance % 2]
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    if size == 8:
        rows = [
            (n * 10**6, socketcan((n + chance) % 3 | (0x8000_0000 * (each[0] > 0xF0)), each)) for n, each in enumerate(pieces)
        ]
    else:
        rows = [(n * 10**6, each) for n, each in enumerate(pieces)]
    path = place.folder / "in.pcap"
    path.write_bytes(pcap_file(_LINK_CAN if size == 8 else _LINK_USER, rows))
    (place.folder / "servotap.lua").write_text(_script())
    name = [d.name for d in dialects.every() if d.bus != "can"][chance // 2 % 3]
    dialect = ["-o", f"servotap.dialect:{name}"] if chance % 5 else []
    words = [TSHARK, "-X", "lua_script:servotap.lua", "-r", str(path), *LINKS["user"][2], *dialect]
    if chance % 3 == 0:
        words.append("-2")
    # Its own checks of a profile and of a user's folder are not asked for here.
    done = subprocess.run([*words, "-V"], cwd=place.folder, capture_output=True, timeout=_TSHARK_S)
    said = done.stderr + done.stdout
    lines = [line for line in said.decode("utf-8", "replace").splitlines() if _OWN_FAULT.search(line)]
    if done.returncode or lines:
        raise Fault(f"tshark ended with {done.returncode}: {lines[:5] or done.stderr.decode()[-400:]}")
    if done.stdout.count(b"\nFrame ") + done.stdout.startswith(b"Frame ") != len(pieces):
        raise Fault(f"{len(pieces)} packets went in, others came out")


@cache
def _script() -> str:
    return dissector(dialects.every())
