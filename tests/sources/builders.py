"""Small captures of every format, made with the real libraries where there are any."""

from __future__ import annotations

import importlib
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import can
import can.io.mf4
import pytest
from mcap.writer import CompressionType, Writer

from tests.logic import waves

START_NS = 1_682_894_455_899_123_000
#: (identifier, data, sent by the host) of an exchange with a CAN drive.
CAN_TRAFFIC = (
    (0x001, "F6 01 40 02 3A", True),
    (0x001, "F6 01 F8", False),
    (0x001, "30 31", True),
    (0x001, "30 00 00 00 00 12 34 77", False),
)
#: (bytes, sent by the host) of an exchange with an RS485 drive.
SERIAL_TRAFFIC = (
    ("FA 01 F6 01 40 02 34", True),
    ("FB 01 F6 01 F3", False),
    ("FA 01 32 2D", True),
    ("FB 01 32 01 40 6F", False),
)
STEP_NS = 1_234_567


def times(count: int) -> list[int]:
    """Return rising times."""
    return [START_NS + n * STEP_NS for n in range(count)]


def decimal(t_ns: int, digits: int = 6) -> str:
    """Return a time in seconds with a number of digits, cut off."""
    return f"{t_ns // 10**9}.{t_ns % 10**9:09d}"[: len(str(t_ns // 10**9)) + 1 + digits]


def messages(count: int = 40, channel: int | None = 0) -> list[can.Message]:
    """Return CAN traffic as python-can's messages, times in whole microseconds."""
    given = []
    for n in range(count):
        ident, data, sent = CAN_TRAFFIC[n % len(CAN_TRAFFIC)]
        given.append(
            can.Message(
                timestamp=(START_NS + n * 1_000_000) / 1e9,
                arbitration_id=ident,
                is_extended_id=False,
                data=bytes.fromhex(data),
                is_rx=not sent,
                channel=channel,
            )
        )
    return given


def by_python_can(path: Path, given: list[can.Message]) -> Path:
    """Write messages with the writer that the path's ending chooses."""
    if path.suffix == ".mf4":
        pytest.importorskip("asammdf", reason="MF4 needs asammdf, an extra")
        logger = importlib.reload(can.io.mf4).MF4Writer(path)
    else:
        logger = can.Logger(str(path))
    with logger:
        for message in given:
            logger(message)
    return path


def candump(path: Path) -> Path:
    """Log lines with nine digits and marks."""
    rows = zip(times(40), CAN_TRAFFIC * 10, strict=True)
    text = "".join(
        f"({decimal(t, 9)}) can0 {ident:03X}#{data.replace(' ', '')} {'T' if sent else 'R'}\n"
        for t, (ident, data, sent) in rows
    )
    path.write_text(text)
    return path


def candump_screen(path: Path) -> Path:
    """Lines as on the screen."""
    rows = zip(times(40), CAN_TRAFFIC * 10, strict=True)
    text = "".join(f" ({decimal(t)})  can0  {ident:03X}   [{len(data.split())}]  {data}\n" for t, (ident, data, _) in rows)
    path.write_text(text)
    return path


def can_text(path: Path) -> Path:
    """What python-can prints."""
    rows = zip(times(40), CAN_TRAFFIC * 10, strict=True)
    text = "".join(
        f"Timestamp: {decimal(t)}        ID: {ident:04x}    S {'Tx' if sent else 'Rx'}                "
        f"DL: {len(data.split()):2}    {data.lower():<24}  Channel: can0\n"
        for t, (ident, data, sent) in rows
    )
    path.write_text(text)
    return path


def can_state(path: Path) -> Path:
    """What a shell shows: frames of candump, and the kernel and ip on the controller."""
    rows = "".join(f"  can0  {ident:03X}   [{len(data.split())}]  {data}\n" for ident, data, _ in CAN_TRAFFIC * 10)
    path.write_text(
        f"{rows}write: No buffer space available\n[  867.234914] mttcan c320000.mttcan can0: entered bus off state\n"
        "    can state BUS-OFF (berr-counter tx 248 rx 0) restart-ms 0\n"
    )
    return path


def savvycan(path: Path) -> Path:
    """SavvyCAN's CSV."""
    rows = zip(times(40), CAN_TRAFFIC * 10, strict=True)
    text = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n" + "".join(
        f"{t // 1000},{ident:08X},false,{'Tx' if sent else 'Rx'},0,{len(data.split())},{data.replace(' ', ',')}\n"
        for t, (ident, data, sent) in rows
    )
    path.write_text(text)
    return path


def json_lines(path: Path) -> Path:
    """JSON lines of a serial line."""
    rows = zip(times(40), SERIAL_TRAFFIC * 10, strict=True)
    text = "".join(
        f'{{"time": {decimal(t)}, "dir": "{"tx" if sent else "rx"}", "data": "{data}"}}\n' for t, (data, sent) in rows
    )
    path.write_text(text)
    return path


def hextext(path: Path) -> Path:
    """Lines with times and marks."""
    rows = zip(times(40), SERIAL_TRAFFIC * 10, strict=True)
    path.write_text("".join(f"{decimal(t)} {'TX' if sent else 'RX'}: {data}\n" for t, (data, sent) in rows))
    return path


def raw(path: Path) -> Path:
    """Bytes and nothing else."""
    path.write_bytes(b"".join(bytes.fromhex(data) for data, _ in SERIAL_TRAFFIC * 10))
    return path


def spy_row(seconds: float, mark: str, offset: int, data: bytes) -> str:
    """A row as pyserial's protocol_spy prints it."""
    digits = "".join(f"{b:02X} " + (" " if n == 7 else "") for n, b in enumerate(data))
    digits += "".join("   " + (" " if n == 7 else "") for n in range(len(data), 16))
    characters = "".join(chr(b) if 0x20 <= b < 0x7F else "." for b in data)
    return f"{seconds:010.3f} {mark:4} {offset:04X}  {digits} {characters}\n"


def spy(path: Path) -> Path:
    """A log of a spy:// port."""
    text = "000000.000 Q-RX reset_input_buffer\n"
    for n, (data, sent) in enumerate(SERIAL_TRAFFIC * 10):
        text += spy_row(1 + n * 0.004, "TX" if sent else "RX", 0, bytes.fromhex(data))
    path.write_text(text)
    return path


def saleae(path: Path) -> Path:
    """Logic 1: a byte a row."""
    data = b"".join(bytes.fromhex(data) for data, _ in SERIAL_TRAFFIC * 4)
    rows = "".join(f"{0.001 + n * 0.0001:.15f},0x{b:02X},,\n" for n, b in enumerate(data))
    path.write_text("Time [s],Value,Parity Error,Framing Error\n" + rows)
    return path


def sigrok(path: Path) -> Path:
    """sigrok-cli with sample numbers and classes."""
    text, at = "", 1000
    for data, sent in SERIAL_TRAFFIC * 4:
        for value in bytes.fromhex(data):
            text += f"{at}-{at + 80} uart-1: {'tx' if sent else 'rx'}-data: {value:02X}\n"
            at += 100
    path.write_text(text)
    return path


def hexdump(path: Path) -> Path:
    """As hexdump -C prints the raw bytes."""
    data = b"".join(bytes.fromhex(data) for data, _ in SERIAL_TRAFFIC * 10)
    text = ""
    for at in range(0, len(data), 16):
        row = data[at : at + 16]
        digits = f"{row[:8].hex(' ')}  {row[8:].hex(' ')}"
        text += f"{at:08x}  {digits:<48}  |{''.join(chr(b) if 0x20 <= b < 0x7F else '.' for b in row)}|\n"
    path.write_text(text + f"{len(data):08x}\n")
    return path


def socketcan(ident: int, data: bytes, flags: int = 0) -> bytes:
    """A CAN frame as pcap holds it."""
    return struct.pack(">LBB2x", ident, len(data), flags) + data


def pcap_file(link: int, given: list[tuple[int, bytes]], order: str = "<", nano: bool = True) -> bytes:
    """A classic pcap file of (time, data)."""
    unit = 1 if nano else 1000
    out = struct.pack(order + "LHHlLLL", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, 262144, link)
    for t_ns, data in given:
        out += struct.pack(order + "LLLL", t_ns // 10**9, t_ns % 10**9 // unit, len(data), len(data)) + data
    return out


def pcap(path: Path) -> Path:
    """SocketCAN frames."""
    rows = zip(times(40), CAN_TRAFFIC * 10, strict=True)
    path.write_bytes(pcap_file(227, [(t, socketcan(i, bytes.fromhex(d))) for t, (i, d, _) in rows]))
    return path


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """A block of pcapng."""
    body += b"\0" * (-len(body) % 4)
    size = struct.pack(order + "L", len(body) + 12)
    return struct.pack(order + "L", kind) + size + body + size


def option(code: int, data: bytes, order: str = "<") -> bytes:
    """An option of a pcapng block."""
    return struct.pack(order + "HH", code, len(data)) + data + b"\0" * (-len(data) % 4)


def section(order: str = "<", options: bytes = b"") -> bytes:
    """A section header of pcapng."""
    return block(0x0A0D0D0A, struct.pack(order + "LHHq", 0x1A2B3C4D, 1, 0, -1) + options, order)


def interface(link: int, name: str = "", resolution: int = 9, order: str = "<") -> bytes:
    """An interface of pcapng."""
    options = option(2, name.encode(), order) if name else b""
    options += option(9, bytes((resolution,)), order) + option(0, b"", order)
    return block(1, struct.pack(order + "HHL", link, 0, 0) + options, order)


def enhanced(number: int, ticks: int, data: bytes, options: bytes = b"", order: str = "<") -> bytes:
    """An enhanced packet block of pcapng."""
    head = struct.pack(order + "LLLLL", number, ticks >> 32, ticks & 0xFFFF_FFFF, len(data), len(data))
    return block(6, head + data + b"\0" * (-len(data) % 4) + options, order)


def pcapng(path: Path) -> Path:
    """Serial bytes of a USER link, with directions."""
    out = section() + interface(147, "/dev/ttyUSB0")
    for t_ns, (data, sent) in zip(times(40), SERIAL_TRAFFIC * 10, strict=True):
        flags = option(2, struct.pack("<L", 2 if sent else 1)) + option(0, b"")
        out += enhanced(0, t_ns, bytes.fromhex(data), flags)
    path.write_bytes(out)
    return path


def mcap_log(
    path: Path,
    given: list[tuple[str, int, dict[str, object]]],
    kind: str = "serial",
    compression: CompressionType = CompressionType.ZSTD,
    profile: str = "servotap",
) -> Path:
    """An MCAP log of (topic, time, message)."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=400, compression=compression)
        writer.start(profile, "test")
        schema = writer.register_schema("any", "jsonschema", b'{"type":"object"}')
        channels: dict[str, int] = {}
        for topic, t_ns, message in given:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema, {"bus_kind": kind})
            writer.add_message(channels[topic], t_ns, json.dumps(message).encode(), t_ns)
        writer.add_metadata("servotap", {"time_source": "capture: test"})
        writer.finish()
    return path


def log(path: Path) -> Path:
    """A log of RS485 traffic as this program writes it."""
    given: list[tuple[str, int, dict[str, object]]] = []
    offset = 0
    for t_ns, (data, sent) in zip(times(40), SERIAL_TRAFFIC * 10, strict=True):
        topic = f"/left/1/some_command/{'request' if sent else 'reply'}"
        given.append((topic, t_ns, {"_raw": data, "_offset": offset, "_checksum_ok": True, "speed": 320}))
        offset += len(bytes.fromhex(data))
    return mcap_log(path, given)


def _wave() -> waves.Wave:
    rows = [(1e6 + n * 4e6, bytes.fromhex(data)) for n, (data, _) in enumerate(SERIAL_TRAFFIC * 4)]
    return waves.uart(rows, 115200)[0]


def sigrok_session(path: Path) -> Path:
    """Samples of two channels, as PulseView saves them."""
    return waves.write_sr(path, [_wave(), waves.Wave("idle")], 1_000_000)


def vcd(path: Path) -> Path:
    """The same as a value change dump."""
    return waves.write_vcd(path, [_wave(), waves.Wave("idle")], 1_000_000)


def saleae_levels(path: Path) -> Path:
    """The same as Logic 2 exports it as CSV."""
    return waves.write_saleae_csv(path, [_wave(), waves.Wave("idle")], 1_000_000)


def saleae_binary(path: Path) -> Path:
    """One channel as Logic 2 exports it in binary."""
    return waves.write_saleae_binary(path, _wave(), 1_000_000)


@dataclass(frozen=True)
class Sample:
    """A capture that every source test can make. `ending`: of its file name."""

    build: Callable[[Path], Path]
    format: str
    kind: str
    ending: str = ".bin"
    baud: int | None = None

    def make(self, folder: Path) -> Path:
        """Write the capture into a folder."""
        return self.build(folder / f"capture{self.ending}")


def _written(path: Path) -> Path:
    return by_python_can(path, messages())


SAMPLES: dict[str, Sample] = {
    "candump": Sample(candump, "candump", "can"),
    "candump-screen": Sample(candump_screen, "candump", "can"),
    "asc": Sample(_written, "asc", "can", ".asc"),
    "blf": Sample(_written, "blf", "can", ".blf"),
    "trc": Sample(_written, "trc", "can", ".trc"),
    "can-csv": Sample(_written, "can-csv", "can", ".csv"),
    "pcap": Sample(pcap, "pcap", "can"),
    "pcapng": Sample(pcapng, "pcapng", "serial"),
    "hex": Sample(hextext, "hex", "serial"),
    "raw": Sample(raw, "raw", "serial"),
    "can-text": Sample(can_text, "can-text", "can"),
    "can-state": Sample(can_state, "can-state", "can"),
    "columns": Sample(savvycan, "columns", "can"),
    "columns-json": Sample(json_lines, "columns", "serial"),
    "spy": Sample(spy, "spy", "serial"),
    "saleae": Sample(saleae, "saleae", "serial"),
    "sigrok": Sample(sigrok, "sigrok", "serial", baud=115200),
    "sigrok-session": Sample(sigrok_session, "sigrok-session", "serial"),
    "vcd": Sample(vcd, "vcd", "serial"),
    "saleae-levels": Sample(saleae_levels, "saleae-levels", "serial"),
    "saleae-binary": Sample(saleae_binary, "saleae-binary", "serial"),
    "hexdump": Sample(hexdump, "hexdump", "serial"),
    "mcap": Sample(log, "mcap", "log"),
}
#: Samples that are no text.
BINARY = ("blf", "pcap", "pcapng", "raw", "mcap", "sigrok-session", "saleae-binary")
