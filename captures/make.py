"""Make the captures of this folder, and longer ones of any length.

    python captures/make.py                                        the captures and their golden decodes, here
    python captures/make.py --frames 100000 --dialect mks-rs485 --seed 7 -o long.bin      plausible exchanges, raw
    python captures/make.py --frames 100000 --dialect mks-can -o long.log                 the same on CAN, as candump

The sessions are written by hand (`sessions.py`); this file only puts their bytes into each format. The long captures are
drawn from the catalogue: a request with values inside its ranges, then the replies that the manual gives it.
"""

from __future__ import annotations

import argparse
import gzip
import random
import struct
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from sessions import SESSIONS, Row  # noqa: E402

#: 2026-03-02 09:00:00 UTC
START_NS = 1_772_442_000 * 1_000_000_000
MS = 1_000_000


def sum8(data: bytes) -> bytes:
    """Return the low byte of the sum."""
    return bytes((sum(data) & 0xFF,))


def crc16(data: bytes) -> bytes:
    """Return the CRC of Modbus, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value.to_bytes(2, "little")


def lk(row: Row) -> bytes:
    """Return a Lingkong frame: the head and its sum, the data and theirs."""
    head, _, data = row.text.partition("|")
    start, rest = bytes.fromhex(head), bytes.fromhex(data)
    return start + sum8(start) + (rest + sum8(rest) if rest else b"")


def whole(name: str, row: Row) -> bytes:
    """Return the bytes of a row with its check; on CAN the data bytes."""
    if row.raw:
        return bytes.fromhex(row.text)
    if name == "lk_rs485":
        return lk(row)
    if name == "mks_can":
        identifier, data = can_parts(row)
        return data + bytes(((identifier + sum(data)) & 0xFF,))
    data = bytes.fromhex(row.text)
    return data + (crc16(data) if name == "mks_modbus" else sum8(data))


def can_parts(row: Row) -> tuple[int, bytes]:
    """Return the identifier and the data bytes of a CAN row."""
    identifier, _, data = row.text.partition(" ")
    return int(identifier, 16), bytes.fromhex(data)


def frames(name: str) -> list[tuple[int, str, bytes]]:
    """Return (time in ns, sender, bytes) of a session."""
    return [(START_NS + round(row.at * MS), row.sender, whole(name, row)) for row in SESSIONS[name]]


def hexed(data: bytes) -> str:
    """Return hex text with blanks."""
    return data.hex(" ").upper()


def clock(t_ns: int, digits: int) -> str:
    """Return the time of day."""
    text = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).strftime("%H:%M:%S")
    return f"{text}.{t_ns % 1_000_000_000:09d}"[: 9 + digits]


def day(t_ns: int, digits: int) -> str:
    """Return date and time."""
    return datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d ") + clock(t_ns, digits)


# --- serial formats -----------------------------------------------------------------------------------------------


def raw(name: str) -> bytes:
    """Return nothing but the bytes."""
    return b"".join(data for _, _, data in frames(name))


def timed_hex(name: str) -> bytes:
    """Return hex lines with a time and an arrow, and comments."""
    rows = [f"# {name}: one session, times in UTC"]
    rows += [f"{day(t, 6).replace(' ', 'T')}Z {sender} {hexed(data)}" for t, sender, data in frames(name)]
    return ("\n".join(rows) + "\n").encode()


def plain_hex(name: str) -> bytes:
    """Return hex lines and nothing else."""
    return ("\n".join(hexed(data) for _, _, data in frames(name)) + "\n").encode()


def assistant(name: str) -> bytes:
    """Return what the serial assistant of the MKS manual prints."""
    rows = []
    for t, sender, data in frames(name):
        rows += [f"[{day(t, 3)}]# {'SEND' if sender == '>' else 'RECV'} HEX>", hexed(data), ""]
    return "\r\n".join(rows).encode()


def modbus_poll(name: str) -> bytes:
    """Return what Modbus Poll shows in its traffic window."""
    rows = [f"{n:03d}-{'Tx' if s == '>' else 'Rx'}:{hexed(d)}" for n, (_, s, d) in enumerate(frames(name))]
    return ("\r\n".join(rows) + "\r\n").encode()


def sending(name: str) -> bytes:
    """Return the log of a host program that writes Sending and Recieved, with lines of its own between."""
    rows = []
    for _, sender, data in frames(name):
        word = "Sending : " if sender == ">" else "Recieved : "
        rows.append(f"[bus:0] {word} {data.hex(' ')}")
        if sender == "<":
            rows.append("Target:    18000 Encoder:     8192")
    return ("\n".join(rows) + "\n").encode()


def spy(name: str) -> bytes:
    """Return the log of pyserial's spy:// port: hex dump lines of 16 bytes."""
    rows = []
    for t, sender, data in frames(name):
        at = (t - START_NS) / 1e9
        for start in range(0, len(data), 16):
            part = data[start : start + 16]
            text = "".join(chr(b) if 32 <= b < 127 else "." for b in part)
            cells = "".join(f"{b:02X} " + (" " if i == 7 else "") for i, b in enumerate(part))
            rows.append(f"{at:010.3f} {'TX' if sender == '>' else 'RX'}   {start:04X}  {cells:<50}{text}")
    return ("\n".join(rows) + "\n").encode()


def byte_times(name: str, baud: int) -> Iterator[tuple[float, int, str]]:
    """Yield (time in s from the start, byte, sender) for analysers that decode single bytes."""
    for t, sender, data in frames(name):
        for index, byte in enumerate(data):
            yield (t - START_NS) / 1e9 + index * 10 / baud, byte, sender


def saleae1(name: str) -> bytes:
    """Return the CSV of Saleae Logic 1."""
    rows = ["Time [s],Value,Parity Error,Framing Error"]
    rows += [f"{at:.9f},0x{byte:02X},," for at, byte, _ in byte_times(name, 38400)]
    return ("\n".join(rows) + "\n").encode()


def saleae2(name: str) -> bytes:
    """Return the CSV of Saleae Logic 2."""
    rows = ["name,type,start_time,duration,data,error"]
    for at, byte, _ in byte_times(name, 38400):
        rows.append(f'"Async Serial","data",{at:.9f},0.000234375,0x{byte:02X},')
    return ("\n".join(rows) + "\n").encode()


def sigrok(name: str) -> bytes:
    """Return what `sigrok-cli -P uart -A uart=rx-data --protocol-decoder-samplenum` prints at 1 MHz."""
    rows = []
    for at, byte, _ in byte_times(name, 38400):
        first = round(at * 1_000_000)
        rows.append(f"{first}-{first + 208} uart-1: {byte:02X}")
    return ("\n".join(rows) + "\n").encode()


def pcap(records: list[tuple[int, bytes]], link: int) -> bytes:
    """Return a classic pcap with nanoseconds."""
    result = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, link)
    for t, data in records:
        result += struct.pack("<IIII", t // 1_000_000_000, t % 1_000_000_000, len(data), len(data)) + data
    return result


def pcapng(records: list[tuple[int, bytes]], link: int, port: str) -> bytes:
    """Return a pcapng of one interface with nanoseconds."""

    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)

    def option(code: int, value: bytes) -> bytes:
        return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)

    name = option(2, port.encode()) + option(9, b"\x09") + option(0, b"")
    result = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    result += block(1, struct.pack("<HHI", link, 0, 65535) + name)
    for t, data in records:
        result += block(6, struct.pack("<IIIII", 0, t >> 32, t & 0xFFFFFFFF, len(data), len(data)) + data)
    return result


def rtac(name: str) -> list[tuple[int, bytes]]:
    """Return records with the 12-byte head of an RTAC: time, event, control line states, footer."""
    records = []
    for t, sender, data in frames(name):
        event = 0x01 if sender == ">" else 0x02
        head = struct.pack(">IIBBH", t // 1_000_000_000, t % 1_000_000_000 // 1000, event, 0, 0)
        records.append((t, head + data))
    return records


# --- CAN formats --------------------------------------------------------------------------------------------------


def can_rows(name: str) -> list[tuple[int, int, bytes]]:
    """Return (time in ns, identifier, data) of a CAN session."""
    rows = []
    for row in SESSIONS[name]:
        rows.append((START_NS + round(row.at * MS), can_parts(row)[0], whole(name, row)))
    return rows


def candump(name: str) -> bytes:
    """Return what `candump -L can0` prints."""
    rows = [f"({t // 10**9}.{t % 10**9 // 1000:06d}) can0 {i:03X}#{d.hex().upper()}" for t, i, d in can_rows(name)]
    return ("\n".join(rows) + "\n").encode()


def socketcan(name: str) -> list[tuple[int, bytes]]:
    """Return SocketCAN records: identifier, length, padding, data."""
    return [(t, struct.pack(">IBxxx", i, len(d)) + d) for t, i, d in can_rows(name)]


def by_library(name: str, ending: str, target: Path) -> None:
    """Write a CAN session by python-can's writer for the ending."""
    import can

    with can.Logger(str(target.with_suffix(ending))) as writer:
        for t, identifier, data in can_rows(name):
            message = can.Message(
                timestamp=t / 1e9, arbitration_id=identifier, data=data, is_extended_id=False, channel=0, is_rx=True
            )
            writer(message)
    if ending == ".trc":
        # The writer puts the whole path of this machine into the head of the file.
        path = target.with_suffix(ending)
        path.write_bytes(path.read_bytes().replace(str(path.resolve()).encode(), path.name.encode()))


# --- everything ---------------------------------------------------------------------------------------------------

SERIAL = ("mks_rs485", "mks_modbus", "lk_rs485")

#: File name -> what makes its bytes.
FILES: dict[str, Callable[[], bytes]] = {
    **{f"{n}.bin": (lambda n=n: raw(n)) for n in SERIAL},
    **{f"{n}.log": (lambda n=n: timed_hex(n)) for n in SERIAL},
    "mks_rs485.hex.gz": lambda: gzip.compress(plain_hex("mks_rs485"), mtime=0),
    "mks_rs485.assistant.txt": lambda: assistant("mks_rs485"),
    "mks_rs485.spy.log": lambda: spy("mks_rs485"),
    "mks_rs485.saleae1.csv": lambda: saleae1("mks_rs485"),
    "mks_rs485.saleae2.csv": lambda: saleae2("mks_rs485"),
    "mks_rs485.sigrok.txt": lambda: sigrok("mks_rs485"),
    "mks_rs485.user.pcap": lambda: pcap([(t, d) for t, _, d in frames("mks_rs485")], 147),
    "mks_rs485.rtac.pcapng": lambda: pcapng(rtac("mks_rs485"), 250, "left"),
    "mks_modbus.poll.txt": lambda: modbus_poll("mks_modbus"),
    "lk_rs485.sending.log": lambda: sending("lk_rs485"),
    "mks_can.candump.log": lambda: candump("mks_can"),
    "mks_can.socketcan.pcap": lambda: pcap(socketcan("mks_can"), 227),
    "mks_can.socketcan.pcapng": lambda: pcapng(socketcan("mks_can"), 227, "can0"),
}

#: Formats that python-can writes.
LIBRARY = (".asc", ".blf", ".trc", ".csv", ".mf4")


def golden(name: str) -> str:
    """Return the meanings of a session, a line a frame."""
    return "".join(f"{row.meaning}\n" for row in SESSIONS[name])


def make_all(folder: Path) -> list[Path]:
    """Write every capture and golden decode into a folder and return their paths."""
    written = []
    for file, make in FILES.items():
        written.append(folder / file)
        written[-1].write_bytes(make())
    for ending in LIBRARY:
        by_library("mks_can", ending, folder / "mks_can")
        written.append(folder / f"mks_can{ending}")
    from analyzer.cli import main as servotap

    written.append(folder / "mks_rs485.mcap")
    servotap(["decode", str(folder / "mks_rs485.log"), "-o", str(written[-1]), "--force", "--json"])
    for name in SESSIONS:
        written.append(folder / f"{name}.golden")
        written[-1].write_text(golden(name))
    return written


# --- long captures ------------------------------------------------------------------------------------------------


#: Commands that change who answers and how, or whose values depend on each other.
LEFT_OUT = frozenset({
    "set_address", "set_baud_rate", "set_bit_rate", "set_modbus", "set_respond", "set_group_address", "read_parameter",
    "write_parameter",
})  # fmt: skip


def exchanges(dialect_name: str, seed: int) -> Iterator[tuple[int, bytes]]:
    """Yield (address, bytes) of requests and replies without end, drawn from the catalogue: mostly reads."""
    from analyzer import dialects
    from analyzer.catalogue import Form, Role
    from analyzer.codec import codec

    chance = random.Random(seed)
    dialect = dialects.get(dialect_name)
    link = dialect.link
    reads = [c for c in dialect.commands if c.name.startswith("read_") and c.name != "read_parameter"]
    others = [c for c in dialect.commands if c.reply_forms and c.slots is None and c not in reads and not c.models]
    others = [c for c in others if c.name not in LEFT_OUT]

    def draw(form: Form) -> bytes:
        values = {}
        for name, field in form.layout.named.items():
            if field.fixed is not None or field.bit_width == 0:
                continue
            allowed = sorted(field.values or field.choice_names)
            values[name] = chance.choice(allowed) if allowed else chance.randint(field.low, field.high)
        return codec(form.layout).encode(values)

    while True:
        command = chance.choice(reads if chance.random() < 0.85 else others)
        address = chance.randint(1, 4)
        ask = chance.choice([f for f in command.request_forms if not f.models])
        yield address, link.build(command, ask, address, draw(ask), Role.REQUEST)
        good = [f for f in command.reply_forms if f.name not in command.replies.failed_forms and f.code is None]
        answer = good[0]
        data = draw(answer)
        status = answer.layout.named.get(command.replies.status)
        if command.function in (0x06,):
            data = draw(answer) if answer.layout != ask.layout else data
        if status is not None and command.judged:
            data = codec(answer.layout).encode({command.replies.status: max(command.replies.final)})
        yield address, link.build(command, answer, address, data, Role.REPLY)


def make_long(dialect: str, count: int, seed: int, target: Path) -> None:
    """Write a long capture: raw bytes for serial dialects, candump lines for CAN."""
    stream = exchanges(dialect, seed)
    with target.open("wb") as out:
        for number in range(count):
            address, data = next(stream)
            if "can" in dialect:
                t = START_NS + number * 250_000
                out.write(b"(%d.%06d) can0 %03X#%b\n" % (t // 10**9, t % 10**9 // 1000, address, data.hex().upper().encode()))
            else:
                out.write(data)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, help="make a long capture of this many frames instead")
    parser.add_argument("--dialect", default="mks-rs485")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, help="the long capture, or the folder for the others (here)")
    arguments = parser.parse_args()
    if arguments.frames:
        make_long(arguments.dialect, arguments.frames, arguments.seed, arguments.output or Path("long.bin"))
        return
    for path in make_all(arguments.output or HERE):
        print(path.name)


if __name__ == "__main__":
    main()
