"""The dissector for Wireshark beside our own decoding: the captures of the project, and generated frames of each command."""

from __future__ import annotations

import json
import random
import re
import shutil
import struct
import subprocess
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.cli import main
from analyzer.codec import codec
from analyzer.layout import FieldKind, Order
from analyzer.reference.wireshark import dissector

CAPTURES = Path(__file__).parents[2] / "captures"
TSHARK = shutil.which("tshark")
needs_tshark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed: apt install tshark")
USER = 'uat:user_dlts:"User 0 (DLT=147)","servotap","0","","0",""'
DLT_USER0, DLT_CAN_SOCKETCAN = 147, 227


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lua") / "servotap.lua"
    path.write_text(dissector(dialects.every()))
    return path


def seen_by_tshark(script: Path, capture: Path, *words: str) -> list[dict[str, Any]]:
    """Return the frames as the dissector has them, each with its fields by name."""
    command = [str(TSHARK), "-X", f"lua_script:{script}", "-r", str(capture), "-T", "json", "--no-duplicate-keys", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    assert "Lua:" not in done.stderr, done.stderr
    found = []
    for packet in json.loads(done.stdout):
        layer = packet["_source"]["layers"].get("servotap", [])
        found += layer if isinstance(layer, list) else [layer]
    return found


def seen_by_us(capture: Path, capsys: pytest.CaptureFixture[str], *words: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert main(["show", str(capture), "--json", *words]) in (0, 1)
    every = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    return [each for each in every if each.get("raw") and "junk" not in each]


def compare(ours: dict[str, Any], theirs: dict[str, Any], *, paired: bool = True, numbered: bool = False) -> None:
    """Hold a frame's command, sender, check and values together; `paired`: and what it answers.

    `numbered`: the capture has a frame in each packet, so that the request can be held against ours, too.
    """
    about = (ours, theirs)
    assert theirs["servotap.command"] == ours["command"], about
    assert theirs["servotap.role"] == ours["role"], about
    assert int(theirs["servotap.address"]) == ours["address"], about
    assert (theirs["servotap.checksum_ok"] in ("1", 1, True)) == ours["checksum_ok"], about
    compare_fields(ours, theirs)
    slots = theirs.get("servotap.data_tree", []) if "slots" in ours else []
    for mine, other in zip(ours.get("slots", []), slots if isinstance(slots, list) else [slots], strict=True):
        assert (int(other["servotap.address"]), other.get("servotap.command")) == (mine["address"], mine.get("command")), about
        compare_fields(mine, other)
    assert set(experts(theirs)) & JUDGED == set(ours["findings"]) & JUDGED, about
    if not paired:
        return
    if ours.get("latency") is not None:
        assert float(theirs["servotap.latency"]) == pytest.approx(ours["latency"], abs=2e-6), about
    assert ("servotap.request_in" in theirs) == ("request_sequence" in ours), about
    if numbered and "request_sequence" in ours:
        assert int(theirs["servotap.request_in"]) == ours["request_sequence"], about


def compare_fields(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    fields = {key.rpartition(".")[2]: value for key, value in theirs.items() if key.count(".") >= 3}
    expected = {
        key: value
        for key, value in ours.items()
        if isinstance(value, (int, float)) and key not in NOT_FIELDS and not isinstance(value, bool)
    }
    assert {k: float(v) for k, v in fields.items() if k in expected} == pytest.approx(expected, rel=1e-9), (ours, theirs)


def experts(layer: Any) -> Iterator[str]:
    """Yield the expert infos of a frame by their names, which are those of our rules."""
    if isinstance(layer, list):
        for each in layer:
            yield from experts(each)
    elif isinstance(layer, dict):
        for key, value in layer.items():
            if key == "_ws.expert":
                for each in value if isinstance(value, list) else [value]:
                    yield from (name.removeprefix("servotap.") for name in each if name.startswith("servotap."))
            else:
                yield from experts(value)


#: Rules that the dissector has, too.
JUDGED = {"bad_checksum", "out_of_range", "unknown_choice", "reserved_bits", "wrong_length", "unknown_command"}
NOT_FIELDS = {"time", "address", "code", "offset", "sequence", "latency", "request_sequence"}


@needs_tshark
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mks_can.socketcan.pcap", []),
        ("mks_can.socketcan.pcapng", []),
        ("mks_rs485.rtac.pcapng", ["-d", "rtacser.data,servotap"]),
        ("mks_rs485.user.pcap", ["-o", USER]),
        # Twice, as the window of Wireshark looks at packets.
        ("mks_rs485.user.pcap", ["-o", USER, "-2"]),
        ("mks_can.socketcan.pcap", ["-2"]),
    ],
)
def test_the_captures_of_the_project(name: str, words: list[str], script: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = seen_by_us(CAPTURES / name, capsys)
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


def data_of(form: Form, rng: random.Random) -> bytes:
    """Return data of a form: any bits, half of the time values that the manual allows."""
    total, strict = 0, rng.random() < 0.5
    for field in form.layout.fields:
        value = rng.getrandbits(field.bit_width) if field.bit_width else 0
        if field.kind is FieldKind.RESERVED:
            value = 0
        elif field.fixed is not None:
            value = field.fixed
        elif strict and (field.choices is not None or field.values is not None):
            value = rng.choice([v for v in (field.values or field.choice_names) if field.allows(v)])
        elif strict:
            value = rng.randint(field.low, field.high)
        value &= (1 << field.bit_width) - 1
        if field.order is Order.LITTLE:
            value = int.from_bytes(value.to_bytes(field.bit_width // 8, "little"), "big")
        total = total << field.bit_width | value
    return total.to_bytes(form.layout.byte_length, "big")


def exchanges(dialect: Dialect, count: int, rng: random.Random) -> Iterator[tuple[int, bytes]]:
    """Yield identifiers and frames: each form of each command, and behind each request a reply; now and then one is damaged."""
    link, address = dialect.link, 5
    first = whole = True

    def sent(frame: bytes) -> tuple[int, bytes]:
        nonlocal first, whole
        # On CAN the first frame has to tell that the node is a drive.
        whole = first or not whole or rng.random() > 0.03
        first = False
        return address, frame if whole else frame[:-1] + bytes((frame[-1] ^ 1 << rng.randrange(8),))

    # What changes who answers comes last.
    for command in sorted(dialect.commands, key=lambda command: command.changes_answers):
        for number in range(count):
            request = command.request_forms[number % len(command.request_forms)]
            data = data_of(request, rng) if command.slots is None else slots_data(dialect, command, rng)
            yield sent(link.build(command, request, address, data, Role.REQUEST))
            asked = {} if command.slots is not None else codec(request.layout).wire(data)
            replies = [f for f in command.reply_forms if (f.request_values or {}).items() <= asked.items()]
            if replies:
                reply = replies[number % len(replies)]
                yield sent(link.build(command, reply, address, data_of(reply, rng), Role.REPLY))


def slots_data(dialect: Dialect, command: Command, rng: random.Random) -> bytes:
    """Return the data of a package with requests to some drives, and unused slots behind them."""
    assert command.slots is not None
    size, count = command.slots.size, command.slots.count
    data = b""
    for address in range(1, rng.randint(2, count + 1)):
        inner = rng.choice([c for c in dialect.commands if c.slots is None])
        form = rng.choice(inner.request_forms)
        data += (bytes((address, inner.code)) + data_of(form, rng)).ljust(size, b"\0")[:size]
    return data.ljust(size * count, b"\0")


def capture_of(dialect: Dialect, frames: list[tuple[int, bytes]], path: Path) -> Path:
    """Write frames as packets of a pcap file, 10 ms apart."""
    can = dialect.bus == "can"
    out = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, DLT_CAN_SOCKETCAN if can else DLT_USER0)]
    for number, (identifier, data) in enumerate(frames):
        packet = struct.pack(">IB3x8s", identifier, len(data), data) if can else data
        seconds, hundredths = divmod(number, 100)
        out.append(struct.pack("<IIII", 1_700_000_000 + seconds, hundredths * 10_000, len(packet), len(packet)) + packet)
    path.write_bytes(b"".join(out))
    return path


@needs_tshark
@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda dialect: dialect.name)
def test_generated_frames_of_each_command(
    dialect: Dialect, script: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = list(exchanges(dialect, 4, random.Random(15)))
    path = capture_of(dialect, frames, tmp_path / "made.pcap")
    ours = seen_by_us(path, capsys, "--dialect", dialect.name)
    theirs = seen_by_tshark(script, path, "-o", USER, "-o", f"servotap.dialect:{dialect.name}")
    assert len(theirs) == len(ours) == len(frames)
    for mine, other in zip(ours, theirs, strict=True):
        compare(mine, other, numbered=True)


@needs_tshark
@pytest.mark.parametrize("name", ["mks-rs485", "mks-can", "mks-modbus", "lk-rs485"])
def test_replies_that_are_late_missing_or_repeated(
    name: str, script: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dialect, rng = dialects.get(name), random.Random(16)
    sent = list(exchanges(dialect, 12, rng))
    frames: list[tuple[int, bytes]] = []
    held: list[tuple[int, bytes]] = []
    for frame in sent:
        fate = rng.random()
        frames += [frame] if fate < 0.7 else [frame, frame] if fate < 0.8 else []
        held += [frame] if fate > 0.9 else []
        if len(held) > 3:
            frames.append(held.pop(0))
    path = capture_of(dialect, frames, tmp_path / "made.pcap")
    ours = seen_by_us(path, capsys, "--dialect", name)
    theirs = seen_by_tshark(script, path, "-o", USER, "-o", f"servotap.dialect:{name}")
    assert len(theirs) == len(ours) == len(frames)
    for mine, other in zip(ours, theirs, strict=True):
        compare(mine, other, numbered=True)
