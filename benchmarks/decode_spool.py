"""The decoding process on what readers have stored: how much of a core a full line takes.

    python benchmarks/decode_spool.py [--seconds 10] [--record-bytes 64] [--motion]

A spool of a serial line at 66 thousand frames/s of 6 bytes (400 kB/s) is decoded in full: frames, pairing, findings, the raw
topic, the log, snapshots for a viewer. The result is the CPU time of the process with all threads, per second of traffic.
"""

from __future__ import annotations

import argparse
import gc
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer.live.config import CONTROL, PortConfig, RecordingConfig  # noqa: E402
from analyzer.live.recorder import Recorder  # noqa: E402
from analyzer.live.spool import RecordKind, SpoolWriter, pack, pack_event, spool_folder  # noqa: E402

FRAMES_A_SECOND = 66_000
BYTE_NS = 2_500
START_NS = 1_000_000_000


def with_sum(text: str) -> bytes:
    data = bytes.fromhex(text)
    return data + bytes((sum(data) & 0xFF,))


def spool(folder: Path, log: Path, frames: int, size: int, motion: bool) -> int:
    """Write what a reader would have stored; return the bytes of traffic."""
    port = PortConfig(
        stem="1-left", bus="left", endpoint="serial:/dev/ttyUSB0", kind="serial", speed=4_000_000, byte_ns=BYTE_NS,
        dialects=("mks-rs485",),
    )  # fmt: skip
    RecordingConfig(log=str(log), ports=(port,), anchor_monotonic_ns=START_NS, anchor_utc_ns=time.time_ns()).save(folder)
    exchange = (
        with_sum("FA 01 F6 01 40 02") + with_sum("FB 01 F6 01")
        if motion
        else with_sum("FA 01 33") + with_sum("FB 01 33 00 00 12 34")
    )
    data = exchange * (frames // 2)
    reader, control = SpoolWriter(folder, port.stem), SpoolWriter(folder, CONTROL)
    t_ns, batch = START_NS, []
    for at in range(0, len(data), size):
        piece = data[at : at + size]
        t_ns += len(piece) * BYTE_NS
        batch.append(pack(RecordKind.DATA, t_ns, at, piece))
        if len(batch) >= 256:
            reader.write(b"".join(batch))
            batch.clear()
    reader.write(b"".join(batch) or pack(RecordKind.IDLE, t_ns, len(data), b""))
    control.write(pack_event(t_ns, 0, "end", reason="the benchmark is over"))
    reader.close()
    control.close()
    return len(data)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="of traffic")
    parser.add_argument("--record-bytes", type=int, default=64, help="bytes that a reader stores at a time")
    parser.add_argument("--motion", action="store_true", help="motion commands instead of reads")
    arguments = parser.parse_args()
    frames = int(FRAMES_A_SECOND * arguments.seconds)
    with tempfile.TemporaryDirectory() as name:
        log = Path(name) / "out.mcap"
        folder = spool_folder(log)
        folder.mkdir()
        size = spool(folder, log, frames, arguments.record_bytes, arguments.motion)
        recorder = Recorder(folder, feed_fd=os.open(os.devnull, os.O_WRONLY))
        gc.collect()
        gc.freeze()
        began, cpu = time.perf_counter(), time.process_time()
        recorder.run()
        took, cpu = time.perf_counter() - began, time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{frames} frames, {size} bytes, {arguments.record_bytes} bytes a record: {frames / cpu:,.0f} frames/s of CPU; "
            f"{FRAMES_A_SECOND:,} frames/s take {100 * FRAMES_A_SECOND * cpu / frames:.0f} % of a core "
            f"(wall {took:.1f} s, log {log.stat().st_size / 1e6:.1f} MB, peak {peak:.0f} MB)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
