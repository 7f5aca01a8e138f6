"""Generated frames of each command, as Wireshark's dissector has them and as we do:

    python -m tests.reference.beside_wireshark --exchanges 1000

For each dialect and each link that Wireshark knows it prints how many frames the two decode alike. Ends with 1 if they differ.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.codec import codec
from analyzer.layout import FieldKind, Order
from analyzer.reference.wireshark import dissector

TSHARK = shutil.which("tshark")
AT_ONCE = 50
#: A frame on its way: who sends it, the drive's address or identifier, its bytes.
Sent = tuple[Role, int, bytes]

# --- what the two see -------------------------------------------------------------------------------------------------------


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


def seen_by_us(capture: Path, *words: str) -> list[dict[str, Any]]:
    """Return the frames as `servotap show` has them."""
    command = [sys.executable, "-m", "analyzer", "show", str(capture), "--json", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode in (0, 1), done.stderr
    every = [json.loads(line) for line in done.stdout.splitlines()]
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


# --- generated traffic ------------------------------------------------------------------------------------------------------


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


def exchanges(dialect: Dialect, count: int, rng: random.Random) -> Iterator[Sent]:
    """Yield frames: each form of each command, and behind each request a reply; now and then one is damaged."""
    link, address = dialect.link, 5
    first = whole = True

    def sent(role: Role, form: Form, data: bytes) -> Sent:
        nonlocal first, whole
        # On CAN the first frame has to tell that the node is a drive.
        whole = first or not whole or rng.random() > 0.03
        first = False
        frame = link.build(command, form, address, data, role)
        return role, address, frame if whole else frame[:-1] + bytes((frame[-1] ^ 1 << rng.randrange(8),))

    # What changes who answers comes last.
    for command in sorted(dialect.commands, key=lambda command: command.changes_answers):
        for number in range(count):
            request = command.request_forms[number % len(command.request_forms)]
            data = data_of(request, rng) if command.slots is None else slots_data(dialect, command, rng)
            yield sent(Role.REQUEST, request, data)
            asked = {} if command.slots is not None else codec(request.layout).wire(data)
            replies = [f for f in command.reply_forms if (f.request_values or {}).items() <= asked.items()]
            if replies:
                reply = replies[number % len(replies)]
                yield sent(Role.REPLY, reply, data_of(reply, rng))


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


# --- links ------------------------------------------------------------------------------------------------------------------

_PORT = 4001


def _socketcan(number: int, sent: Sent, before: dict[Role, int]) -> bytes:
    _, identifier, data = sent
    return struct.pack(">IB3x8s", identifier, len(data), data)


def _user(number: int, sent: Sent, before: dict[Role, int]) -> bytes:
    return sent[2]


def _rtac(number: int, sent: Sent, before: dict[Role, int]) -> bytes:
    role, _, data = sent
    return struct.pack(">LLBBH", 1_700_000_000, number, 1 if role is Role.REQUEST else 2, 0, 0) + data


def _tcp(number: int, sent: Sent, before: dict[Role, int]) -> bytes:
    """Return a segment between a client and a terminal server, whose stream goes on where `before` says."""
    role, _, data = sent
    to_server = role is Role.REQUEST
    ends, hosts = ((50_000, _PORT), (1, 2)) if to_server else ((_PORT, 50_000), (2, 1))
    sequence, seen = before.get(role, 1), before.get(Role.REPLY if to_server else Role.REQUEST, 1)
    before[role] = sequence + len(data)
    segment = struct.pack(">HHIIBBHHH", *ends, sequence, seen, 5 << 4, 0x18, 65535, 0, 0) + data
    addresses = bytes((10, 0, 0, hosts[0], 10, 0, 0, hosts[1]))
    packet = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), number & 0xFFFF, 0, 64, 6, 0) + addresses + segment
    return bytes(12) + b"\x08\0" + packet


#: Link types of Wireshark: number, how a frame becomes a packet, what tshark is told.
LINKS = {
    "socketcan": (227, _socketcan, []),
    "user": (147, _user, ["-o", 'uat:user_dlts:"User 0 (DLT=147)","servotap","0","","0",""']),
    "rtac": (250, _rtac, ["-d", "rtacser.data,servotap"]),
    "tcp": (1, _tcp, ["-d", f"tcp.port=={_PORT},servotap"]),
}
#: Each dialect on each link that carries it.
PAIRS = [(d, link) for d in dialects.every() for link in (["socketcan"] if d.bus == "can" else ["user", "rtac", "tcp"])]


def capture_of(frames: list[Sent], link: str, path: Path) -> Path:
    """Write frames as packets of a pcap file, 10 ms apart."""
    kind, pack, _ = LINKS[link]
    before: dict[Role, int] = {}
    with path.open("wb") as out:
        out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, kind))
        for number, frame in enumerate(frames):
            packet = pack(number, frame, before)
            seconds, hundredths = divmod(number, 100)
            out.write(struct.pack("<IIII", 1_700_000_000 + seconds, hundredths * 10_000, len(packet), len(packet)) + packet)
    return path


def hold_together(frames: list[Sent], dialect: Dialect, link: str, script: Path, folder: Path) -> int:
    """Decode frames both ways and compare them one by one; return how many. Raises AssertionError where they differ."""
    # Our own reader takes no TCP; the frames are the same.
    capture = capture_of(frames, "socketcan" if link == "socketcan" else "user", folder / "ours.pcap")
    ours = seen_by_us(capture, "--dialect", dialect.name)
    path = capture_of(frames, link, folder / "theirs.pcap")
    theirs = seen_by_tshark(script, path, *LINKS[link][2], "-o", f"servotap.dialect:{dialect.name}")
    assert len(theirs) == len(ours) == len(frames)
    for mine, other in zip(ours, theirs, strict=True):
        compare(mine, other, numbered=True)
    return len(frames)


def write_script(path: Path) -> Path:
    """Write the dissector of all dialects."""
    path.write_text(dissector(dialects.every()))
    return path


def main() -> int:
    """Compare as the options say; return 1 if something differs."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.reference.beside_wireshark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--exchanges", type=int, default=1000, help="of each command (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=15)
    parser.add_argument("--dialect", choices=[d.name for d in dialects.every()])
    arguments = parser.parse_args()
    differing = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = write_script(folder / "servotap.lua")
        for dialect, link in PAIRS:
            if arguments.dialect in (None, dialect.name):
                alike, chance = 0, random.Random(arguments.seed)
                try:
                    # What tshark prints of a frame is long: some thousand at a time.
                    for _ in range(0, arguments.exchanges, AT_ONCE):
                        alike += hold_together(list(exchanges(dialect, AT_ONCE, chance)), dialect, link, script, folder)
                except AssertionError as error:
                    differing += 1
                    print(f"{dialect.name:<11} {link:<10} behind {alike} frames: {error}", flush=True)
                else:
                    print(f"{dialect.name:<11} {link:<10} {alike:>8} frames alike", flush=True)
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
