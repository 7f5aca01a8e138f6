#!/usr/bin/env python3
"""How many replies a second emulated drives give, and how late: in virtual time, over a pseudo-terminal and over TCP.

    python benchmarks/drive_replies.py [--replies N] [--json]

A client asks one drive after another for its speed (LK: its angle) and waits for each reply.

    virtual time      the bus in this process, its clock jumping from event to event
    pty, TCP          `servotap emulate` in a process of its own, the client here; without wire time and reply delay, so
                      that only the program takes time
    pty at N baud     with the times of the wire: `late` is what a reply takes beyond its bytes and its delay
    pymodbus          pymodbus' asynchronous server with its RTU framer over TCP, asked the same by the same client

The peer answers from a table of registers; a drive computes its motor, its ranges and its modes, and each drive on the
line hears every byte.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from conformance.drives import make
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus

ROOT = Path(__file__).resolve().parents[1]
_EMULATE = (
    "import sys; from analyzer.cli import _run; from conformance.cli import emulate;"
    "sys.exit(_run('emulate', emulate, sys.argv[1:]))"
)
_PEER = """
import asyncio
from pymodbus import FramerType
from pymodbus.datastore import ModbusDeviceContext, ModbusSequentialDataBlock, ModbusServerContext
from pymodbus.server import ModbusTcpServer

async def main():
    device = ModbusDeviceContext(ir=ModbusSequentialDataBlock(1, [0] * 300))
    server = ModbusTcpServer(ModbusServerContext(device, single=True), framer=FramerType.RTU, address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    print("listening on 127.0.0.1:%d" % server.transport.sockets[0].getsockname()[1], flush=True)
    await asyncio.Event().wait()

asyncio.run(main())
"""
#: What is asked where it is not the speed.
QUESTIONS = {"lk-rs485": "read_single_turn"}
DELAY_NS = 1_000_000
SECOND_NS = 1_000_000_000
Ask = Callable[[bytes, int], bytes]


def exchange(dialect: str, address: int) -> tuple[bytes, bytes]:
    """Return a request to read something that is zero, and its reply."""
    known, asked = dialects.get(dialect), QUESTIONS.get(dialect, "read_speed")
    return build(known, asked, address), build(known, asked, address, {}, Role.REPLY)


def in_virtual_time(dialect: str, drives: int, replies: int) -> dict[str, Any]:
    made = [make.make(make.parse(f"{dialect}@{i + 1}")) for i in range(drives)]
    pairs = [exchange(dialect, i + 1) for i in range(drives)]
    start = time.perf_counter()
    if dialects.get(dialect).bus == "can":
        can = CanBus(made)
        for number in range(replies):
            can.send(number % drives + 1, pairs[number % drives][0])
            frame = can.receive(SECOND_NS)
            assert frame is not None
        bus: SerialBus | CanBus = can
    else:
        bus = line = SerialBus(made)
        for number in range(replies):
            request, reply = pairs[number % drives]
            line.send(request)
            chunk = line.receive(SECOND_NS)
            assert chunk is not None
            assert chunk.data == reply
    took = time.perf_counter() - start
    return {"way": "virtual time", "dialect": dialect, "drives": drives, "rate": replies / took,
            "faster_than_real": bus.now_ns / 1e9 / took}  # fmt: skip


@contextmanager
def listening(*words: str) -> Iterator[str]:
    """Run a server that says where it listens; yield that place."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line.startswith("listening on "):
            assert process.stderr is not None
            raise RuntimeError(f"not ready: {line}{process.stderr.read()}")
        yield line.removeprefix("listening on ").strip()
    finally:
        process.terminate()
        process.communicate()


def on_terminal(path: str, baud: int) -> Ask:
    import serial

    port = serial.Serial(path, baud, timeout=2)

    def ask(request: bytes, size: int) -> bytes:
        port.write(request)
        data: bytes = port.read(size)
        return data

    return ask


def on_socket(place: str) -> Ask:
    host, _, port = place.rpartition(":")
    client = socket.create_connection((host, int(port)), timeout=2)
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(request: bytes, size: int) -> bytes:
        client.sendall(request)
        data = b""
        while len(data) < size:
            data += client.recv(4096)
        return data

    return ask


def asked(ask: Ask, pairs: Sequence[tuple[bytes, bytes]], replies: int) -> list[float]:
    """Ask for each reply in turn; return the seconds that each took."""
    taken = []
    for number in range(replies):
        request, reply = pairs[number % len(pairs)]
        start = time.perf_counter()
        data = ask(request, len(reply))
        taken.append(time.perf_counter() - start)
        assert data == reply, f"reply {number}: expected {reply.hex(' ')}, got {data.hex(' ')}"
    return taken


def in_real_time(way: str, dialect: str, drives: int, replies: int, baud: int = 0) -> dict[str, Any]:
    names = [f"{dialect}@{i + 1}" + (f",baud={baud}" if baud else "") for i in range(drives)]
    pairs = [exchange(dialect, i + 1) for i in range(drives)]
    words = ["--reply-delay", str(DELAY_NS / 1e6 if baud else 0)] + ([] if baud else ["--no-wire-time"])
    words += ["--tcp", ":0"] if way == "TCP" else ["--pty"]
    with listening(_EMULATE, *names, *words) as place:
        ask = on_socket(place) if way == "TCP" else on_terminal(place, baud or dialects.get(dialect).baud_rates[0])
        asked(ask, pairs, 20)
        start = time.perf_counter()
        taken = asked(ask, pairs, replies)
        took = time.perf_counter() - start
    row = {"way": f"pty at {baud} baud" if baud else way, "dialect": dialect, "drives": drives, "rate": replies / took}
    if baud:
        ideal = DELAY_NS / 1e9 + (len(pairs[0][0]) + len(pairs[0][1])) * 10 / baud
        cuts = statistics.quantiles([1e3 * (t - ideal) for t in taken], n=100)
        row |= {"late_p50_ms": cuts[49], "late_p99_ms": cuts[98]}
    return row


def beside_pymodbus(replies: int) -> list[dict[str, Any]]:
    """Return our rate and pymodbus' for the same request over TCP."""
    rows = [in_real_time("TCP", "mks-modbus", 1, replies)]
    try:
        import pymodbus
    except ImportError:
        print("pymodbus is not installed; that row is left out", file=sys.stderr)
        return rows
    with listening(_PEER) as place:
        pair = exchange("mks-modbus", 1)
        ask = on_socket(place)
        asked(ask, [pair], 20)
        start = time.perf_counter()
        asked(ask, [pair], replies)
        rate = replies / (time.perf_counter() - start)
    rows.append({"way": f"TCP, pymodbus {pymodbus.__version__}", "dialect": "mks-modbus", "drives": 1, "rate": rate})
    return rows


def measure(replies: int) -> list[dict[str, Any]]:
    rows = [in_virtual_time(dialect, 1, replies) for dialect in make.KINDS]
    rows.append(in_virtual_time("mks-rs485", 4, replies))
    rows.append(in_real_time("pty", "mks-rs485", 1, replies))
    rows.append(in_real_time("pty", "mks-rs485", 4, replies))
    rows += [in_real_time("pty", "mks-rs485", 1, replies // 5, baud) for baud in (38400, 256000)]
    return rows + beside_pymodbus(replies)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as a markdown table."""
    lines = [
        "| way | dialect | drives | replies/s | times real | late p50 ms | late p99 ms |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        shown = [f"{row[k]:.2f}" if k in row else "" for k in ("faster_than_real", "late_p50_ms", "late_p99_ms")]
        lines.append(f"| {row['way']} | {row['dialect']} | {row['drives']} | {row['rate']:,.0f} | {' | '.join(shown)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--replies", type=int, default=5000, help="replies a row (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a markdown table")
    options = parser.parse_args(arguments)
    if options.replies < 100:
        parser.error("--replies: expected 100 or more")
    rows = measure(options.replies)
    print(json.dumps(rows, indent=1) if options.json else table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
