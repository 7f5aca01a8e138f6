#!/usr/bin/env python3
"""How fast `servotap record` records without loss, what it costs, and how late its times are; beside python-can's logger.

    python benchmarks/record_rate.py [--seconds S] [--only serial,raw,can,peer] [--first]

serial  a pseudo-terminal at 400 kB/s (4 Mbaud), 66 thousand frames/s, decoded; what arrived is compared byte by byte
raw     the same with --raw-only
can     udp_multicast at 16 thousand frames/s, decoded
peer    python-can's own logger (`python -m can.logger`) on the same traffic

A pseudo-terminal loses nothing by itself: it stops the sender. So the result shows the sender's longest delay: a real
line would have lost bytes after about 160 ms at 400 kB/s. Cores: processor time divided by the time of sending, including
decoding after the end. Lateness: the logged time of the last byte of a chunk (on CAN: of a frame) less the time of its write.

--first gives all processes a high priority (root), for a machine that is otherwise busy.
"""

from __future__ import annotations

import argparse
import bisect
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from record_traffic import Cycle, Recording, Sender, cpu_seconds, go_first, pty_pair, quantile, stamps_of

from analyzer.records import CanFrame, Chunk
from analyzer.sources import open_source

GROUP, PORT = "239.74.163.66", 43113
SERIAL_RATE = 400_000
CAN_RATE = 16_000
#: Whether all of it goes before other processes.
FIRST = False


def lateness(log, stamps, anchor_ns):
    """Nanoseconds by which times in the log are later than those of the sender; and the bytes or frames of the log."""
    ends = [count for count, _ in stamps]
    late, data, frames = [], [], []
    source = open_source(str(log), format=None, baud=None)
    at = 0
    for item in source:
        if isinstance(item, Chunk):
            at += len(item.data)
            data.append(item.data)
        elif isinstance(item, CanFrame):
            at += 1
            frames.append(item.data)
        else:
            continue
        index = bisect.bisect_left(ends, at)
        if index < len(ends):
            late.append(item.t_ns - anchor_ns - stamps[index][1])
    source.close()
    return late, b"".join(data), frames


def anchor_of(log):
    from mcap.reader import make_reader

    with open(log, "rb") as stream:
        for record in make_reader(stream).iter_metadata():
            about = record.metadata
            if "anchor_utc_ns" in about:
                return int(about["anchor_utc_ns"]) - int(about["anchor_monotonic_ns"])
    # UTC of monotonic 0, as it is now: the wall clock is taken not to have been set meanwhile.
    return time.time_ns() - time.monotonic_ns()


def run(name, endpoint, sender, seconds, folder, *words):
    log = folder / f"{name}.mcap"
    times = folder / f"{name}.times"
    recording = Recording(log, endpoint, *words, first=FIRST)
    recording.look()
    before = dict(recording.cpu)
    source = sender(times)
    recording.watch(lambda: source.process.poll() is not None)
    sent = source.wait()
    took = recording.finish()
    span = sent["seconds"]
    behind = max((count["behind"] for count in recording.counts), default=0.0)
    shares = {name: (recording.cpu[name] - before[name]) / span for name in before}
    reader = sum(share for n, share in shares.items() if n not in ("supervisor", "decoding"))
    late, data, frames = lateness(log, stamps_of(times), anchor_of(log))
    port = recording.end["ports"][0]
    late_ms = 1e3 * sent["late_most"]
    print(f"  sent {sent['sent']} in {span:.1f} s, {sent['sent'] / span:.0f}/s; its sender late by {late_ms:.1f} ms")
    print(f"  reader stored {port['count']} {port.get('unit', 'bytes')}, in the log {len(data) or len(frames)}")
    decoded = sum(bus["frames"] for bus in recording.end["buses"].values())
    print(f"  frames decoded {decoded}, {decoded / span:.0f} for each second sent; findings {recording.end['rules'] or 'none'}")
    print(
        f"  cores: reader {reader:.2f}, decoding {shares['decoding']:.2f}, supervisor {shares['supervisor']:.2f}; "
        f"decoding behind {behind:.1f} s at most, finished {took:.1f} s after the end"
    )
    us = [x / 1e3 for x in late]
    p50, p99, most = quantile(us, 0.5), quantile(us, 0.99), max(us, default=0.0)
    print(f"  times late by p50 {p50:.0f} us, p99 {p99:.0f} us, at most {most:.0f} us")
    return sent, data, frames, recording


def serial(seconds, folder, raw):
    kind = "raw" if raw else "serial"
    print(f"## {kind}: {SERIAL_RATE} bytes/s on a pseudo-terminal{' with --raw-only' if raw else ', decoded'}")
    with pty_pair() as (master, path):

        def sender(times):
            words = ("--fd", master, "--rate", SERIAL_RATE, "--seconds", seconds, "--times", times)
            return Sender("serial", *words, pass_fds=(master,), first=FIRST)

        words = ("--raw-only",) if raw else ("--dialect", "mks-rs485")
        sent, data, _, _ = run(kind, f"left=serial:{path},baud=4000000", sender, seconds, folder, *words)
    cycle = Cycle("mks-rs485")
    good = data == cycle.part(0, sent["sent"])
    print(f"  {'every byte is there, in order' if good else 'BYTES ARE MISSING OR WRONG'}")
    print(f"  {len(cycle.frames) / cycle.size * SERIAL_RATE:.0f} frames/s were on the line\n")
    return good


def can(seconds, folder):
    print(f"## can: {CAN_RATE} frames/s on udp_multicast, decoded")

    def sender(times):
        words = ("--group", GROUP, "--port", PORT, "--rate", CAN_RATE, "--seconds", seconds, "--times", times)
        return Sender("can", *words, first=FIRST)

    endpoint = f"arm=can:udp_multicast:{GROUP},port={PORT}"
    sent, _, frames, _ = run("can", endpoint, sender, seconds, folder, "--dialect", "mks-can")
    cycle = Cycle("mks-can")
    good = len(frames) == sent["sent"] and all(frame == cycle.frame(n) for n, frame in enumerate(frames))
    print(f"  {'every frame is there, in order' if good else 'FRAMES ARE MISSING OR WRONG'}\n")
    return good


def udp_waiting(port):
    """Return the bytes that wait to be read at a UDP port; None where no program has opened it."""
    rows = (line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:])
    return next((int(row[4].partition(":")[2], 16) for row in rows if int(row[1].rpartition(":")[2], 16) == port), None)


def until(holds, seconds=30):
    late = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > late:
            raise RuntimeError(f"expected within {seconds} s, did not come")
        time.sleep(0.02)


def peer(seconds, folder):
    print(f"## peer: python -m can.logger, {CAN_RATE} frames/s on udp_multicast, as they came (BLF)")
    log = folder / "peer.blf"
    words = ["-i", "udp_multicast", "-c", GROUP, "-f", str(log)]
    command = [sys.executable, "-m", "can.logger", *words]
    logger = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    if FIRST:
        go_first(logger.pid)
    until(lambda: udp_waiting(PORT) is not None)
    before, began = cpu_seconds(logger.pid), time.monotonic()
    words = ("--group", GROUP, "--port", PORT, "--rate", CAN_RATE, "--seconds", seconds)
    sent = Sender("can", *words, first=FIRST).wait()
    span = time.monotonic() - began
    share = (cpu_seconds(logger.pid) - before) / span
    until(lambda: not udp_waiting(PORT))
    logger.send_signal(signal.SIGINT)
    logger.wait(60)
    import can as python_can

    with python_can.BLFReader(log) as reader:
        count = sum(1 for _ in reader)
    print(f"  sent {sent['sent']}, logged {count}, lost {sent['sent'] - count}; {share:.2f} of a core\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--only", default="serial,raw,can,peer")
    parser.add_argument("--first", action="store_true")
    arguments = parser.parse_args()
    global FIRST
    FIRST = arguments.first
    good = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in arguments.only.split(","):
            if part in ("serial", "raw"):
                good &= serial(arguments.seconds, folder, part == "raw")
            elif part == "can":
                good &= can(arguments.seconds, folder)
            else:
                peer(arguments.seconds, folder)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
