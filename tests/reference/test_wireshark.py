"""The dissector for Wireshark beside our own decoding: the captures of the project, and generated frames of each command."""

from __future__ import annotations

import random
import re
from importlib.resources import files
from pathlib import Path

import pytest

from analyzer.catalogue import Dialect
from analyzer.cli import main
from tests import CAPTURES
from tests.reference.beside_wireshark import (
    LINKS,
    PAIRS,
    TSHARK,
    Sent,
    compare,
    exchanges,
    hold_together,
    seen_by_tshark,
    seen_by_us,
    write_script,
)

needs_tshark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed: apt install tshark")


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_script(tmp_path_factory.mktemp("lua") / "servotap.lua")


@needs_tshark
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mks_can.socketcan.pcap", []),
        ("mks_can.socketcan.pcapng", []),
        ("mks_rs485.rtac.pcapng", LINKS["rtac"][2]),
        ("mks_rs485.user.pcap", LINKS["user"][2]),
        # Twice, as the window of Wireshark looks at packets.
        ("mks_rs485.user.pcap", [*LINKS["user"][2], "-2"]),
        ("mks_can.socketcan.pcap", ["-2"]),
    ],
)
def test_the_captures_of_the_project(name: str, words: list[str], script: Path) -> None:
    ours = seen_by_us(CAPTURES / name)
    theirs = seen_by_tshark(script, CAPTURES / name, *words)
    assert len(ours) == len(theirs) > 10
    for mine, other in zip(ours, theirs, strict=True):
        compare(mine, other)


def test_the_dissector_is_printed_or_written_once(tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    words, target = ["wireshark", "--dialect", "mks-can"], tmp_path / "servotap.lua"
    assert main([*words, "-o", str(target)]) == 0
    assert main(words) == 0
    assert capsysbinary.readouterr().out == target.read_bytes()
    assert main([*words, "-o", str(target)]) == 2
    assert b"exists; --force replaces it" in capsysbinary.readouterr().err


#: What Wireshark 3.6 has of what the engine uses, read in its sources (epan/wslua), and the library of Lua 5.2.
OF_3_6 = {
    "functions": {
        "DissectorTable.get", "Field.new", "Listener.new", "Pref.string", "ProtoExpert.new", "ProtoField.bool",
        "ProtoField.bytes", "ProtoField.double", "ProtoField.framenum", "ProtoField.new", "ProtoField.string",
        "ProtoField.uint16",
    },
    "constants": {
        "base.DEC", "base.NONE", "expert.group.CHECKSUM", "expert.group.MALFORMED", "expert.group.PROTOCOL",
        "expert.group.RESPONSE_CODE", "expert.group.UNDECODED", "expert.severity.ERROR", "expert.severity.NOTE",
        "expert.severity.WARN", "frametype.REQUEST", "frametype.RESPONSE", "ftypes.BYTES", "ftypes.DOUBLE", "ftypes.INT32",
        "ftypes.INT64", "ftypes.UINT32", "ftypes.UINT64",
    },
    "methods": {
        "add", "add_for_decode_as", "add_le", "add_proto_expert_info", "append_text", "bytes", "get_index", "int64", "le_int64",
        "le_uint64", "len", "offset", "register_heuristic", "set", "set_generated", "tonumber", "uint64",
    },
    "attributes": {
        "pinfo.cols.info", "pinfo.cols.protocol", "pinfo.number", "pinfo.rel_ts", "proto.dissector", "proto.experts",
        "proto.fields", "proto.init", "proto.prefs.dialect",
    },
    "library": {
        "math.floor", "math.max", "math.min", "string.format", "table.concat", "table.insert", "table.remove", "table.sort",
    },
}  # fmt: skip
USES = {
    "functions": r"\b[A-Z]\w+\.\w+(?=\()",
    "constants": r"\b(?:ftypes|base|frametype|expert\.(?:group|severity))\.[A-Z]\w*",
    "methods": r"(?<=:)\w+(?=\()",
    "attributes": r"\b(?:pinfo|proto|tvb)\.\w+(?:\.\w+)*",
    "library": r"\b(?:string|table|math|os|io|utf8|debug|coroutine)\.\w+",
}


@pytest.mark.parametrize("kind", OF_3_6)
def test_the_dissector_uses_only_what_wireshark_3_6_has(kind: str) -> None:
    engine = (files("analyzer.reference") / "wireshark.lua").read_text()
    code = re.sub(r'"[^"\n]*"|--[^\n]*', '""', engine)
    assert set(re.findall(USES[kind], code)) == OF_3_6[kind]
    # Operators and words that Lua 5.2 does not have.
    assert not re.search(r"//|<<|>>|~[^=]|[&|]|\bgoto\b|<const>", code)


# --- generated ----------------------------------------------------------------------------------------------------------


def named(each: Dialect | str) -> str:
    return each if isinstance(each, str) else each.name


@needs_tshark
@pytest.mark.parametrize(("dialect", "link"), PAIRS, ids=named)
def test_generated_frames_of_each_command_on_each_link(dialect: Dialect, link: str, script: Path, tmp_path: Path) -> None:
    hold_together(list(exchanges(dialect, 4, random.Random(15))), dialect, link, script, tmp_path)


@needs_tshark
@pytest.mark.parametrize(("dialect", "link"), [pair for pair in PAIRS if pair[1] in ("user", "socketcan")], ids=named)
def test_replies_that_are_late_missing_or_repeated(dialect: Dialect, link: str, script: Path, tmp_path: Path) -> None:
    rng = random.Random(16)
    frames: list[Sent] = []
    held: list[Sent] = []
    for frame in exchanges(dialect, 12, rng):
        fate = rng.random()
        frames += [frame] if fate < 0.7 else [frame, frame] if fate < 0.8 else []
        held += [frame] if fate > 0.9 else []
        if len(held) > 3:
            frames.append(held.pop(0))
    hold_together(frames, dialect, link, script, tmp_path)
