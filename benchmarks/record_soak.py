#!/usr/bin/env python3
"""A long recording at full rates: three serial ports and a CAN bus, checked frame by frame against what was sent.

    python benchmarks/record_soak.py [--seconds S] [--folder F] [--faults] [--baud N] [--can-rate FRAMES]

    left    mks-rs485    256000 baud      25.6 kB/s     pseudo-terminals
    right   mks-modbus   256000 baud      25.6 kB/s
    axis    lk-rs485    2000000 baud       200 kB/s
    arm     mks-can     1 Mbit/s         16000 frames/s udp_multicast

With --baud all serial lines run full at that rate (`--baud 115200`: 11.5 kB/s each). The curve is printed at the end: memory,
how far decoding is behind, frames a second, the size of the log, what was lost.

With --faults a reader and the decoding process are killed now and then. The run passes if the log has all sent
bytes and frames in order, each decoded once, with no finding. Also, no process may grow in memory by more than 20 % (and
4 MiB) from the second quarter of the time to the last.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import msgspec
from mcap.reader import make_reader
from record_traffic import Cycle, Recording, Sender, pty_pair

GROUP, PORT = "239.74.163.67", 43114
#: Bus: dialect, baud, bytes (or frames) a second.
BUSES = {
    "left": ("mks-rs485", 256_000, 25_600),
    "right": ("mks-modbus", 256_000, 25_600),
    "axis": ("lk-rs485", 2_000_000, 200_000),
    "arm": ("mks-can", 1_000_000, 16_000),
}
#: Time between two kills with --faults, in seconds.
KILL_EVERY = 7.0
#: From this long on the memory has to be flat, in seconds.
STEADY = 60.0


class Body(msgspec.Struct):
    """What is read of a decoded message."""

    raw: str = msgspec.field(name="_raw", default="")


def buses_at(baud, can_rate):
    """The buses, their serial lines at another rate, the CAN bus with other traffic, where that was said."""
    found = {}
    for bus, (dialect, own, rate) in BUSES.items():
        if dialect == "mks-can":
            found[bus] = (dialect, own, can_rate or rate)
        else:
            found[bus] = (dialect, baud, baud // 10) if baud else (dialect, own, rate)
    return found


def start(stack, buses, seconds):
    """The endpoints, and what begins to send."""
    endpoints, senders = [], {}
    for bus, (dialect, baud, rate) in buses.items():
        if dialect == "mks-can":
            endpoints.append(f"{bus}=can:udp_multicast:{GROUP},port={PORT},bitrate={baud}")
            words = ("can", "--group", GROUP, "--port", PORT, "--rate", rate, "--seconds", seconds)
            senders[bus] = (words, ())
        else:
            master, path = stack.enter_context(pty_pair())
            endpoints.append(f"{bus}=serial:{path},baud={baud}")
            words = ("serial", "--fd", master, "--dialect", dialect, "--rate", rate, "--seconds", seconds)
            senders[bus] = (words, (master,))
    return endpoints, senders


def kill_one(recording):
    """Kill a reader or the decoding process."""
    recording.processes = recording._children()
    name = random.choice([n for n in recording.processes if n != "supervisor"])
    os.kill(recording.processes[name], signal.SIGKILL)
    return name


def check(log, sent):
    """Compare the log with what was sent; return what is wrong."""
    cycles = {bus: Cycle(dialect) for bus, (dialect, _, _) in BUSES.items()}
    seen = dict.fromkeys(BUSES, 0)
    size = dict.fromkeys(BUSES, 0)
    wrong = []
    decode = msgspec.json.Decoder(Body).decode
    with open(log, "rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            parts = channel.topic.split("/")
            bus, last = parts[1], parts[-1]
            if bus not in cycles or last not in ("request", "reply", "junk", "unknown"):
                continue
            frame = bytes.fromhex(decode(message.data).raw)
            expected = cycles[bus].frame(seen[bus])
            if frame != expected and len(wrong) < 20:
                wrong.append(f"{channel.topic}: frame {seen[bus]} is {frame.hex(' ')}, sent {expected.hex(' ')}")
            seen[bus] += 1
            size[bus] += len(frame)
    for bus, result in sent.items():
        found = seen[bus] if bus == "arm" else size[bus]
        if found != result["sent"]:
            wrong.append(f"{bus}: {found} in the log, {result['sent']} sent")
    return wrong, seen


def growth(memory):
    """Growth of the memory of a process from the second quarter of the time to the last, in bytes and as a share."""
    quarter = len(memory) // 4
    if quarter < 2:
        return 0, 0.0
    before, after = max(memory[quarter : 2 * quarter]), max(memory[-quarter:])
    return after - before, (after - before) / before


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--folder", type=Path, help="where the log goes; about 1 MB a second")
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--baud", type=int, help="rate of the serial lines, instead of those above")
    parser.add_argument("--can-rate", type=int, help="frames a second, instead of 16000")
    arguments = parser.parse_args()
    with ExitStack() as stack:
        folder = arguments.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoints, waiting = start(stack, buses_at(arguments.baud, arguments.can_rate), arguments.seconds)
        dialects = ",".join(dialect for dialect, _, _ in BUSES.values())
        recording = Recording(folder / "soak.mcap", *endpoints, "--dialect", dialects)
        senders = {bus: Sender(*words, pass_fds=fds) for bus, (words, fds) in waiting.items()}
        killed, due = [], time.monotonic() + KILL_EVERY

        def ended():
            nonlocal due
            if arguments.faults and time.monotonic() > due:
                killed.append(kill_one(recording))
                due = time.monotonic() + KILL_EVERY
            return all(sender.process.poll() is not None for sender in senders.values())

        recording.watch(ended, 1.0)
        sent = {bus: sender.wait() for bus, sender in senders.items()}
        processor = dict(recording.cpu)
        memory = {name: list(seen) for name, seen in recording.memory.items()}
        curve(recording, arguments.seconds)
        took = recording.finish()
        wrong = report(recording, sent, processor, memory, took, killed, arguments.seconds)
    for text in wrong:
        print(f"WRONG: {text}")
    print("WRONG" if wrong else "every frame is there, in order, once")
    return 1 if wrong else 0


def curve(recording, seconds):
    """Print how it went over time, in about twenty lines."""
    names = list(recording.memory)
    print(
        "  ".join(
            ("   s", *(f"{name[:12]:>12}" for name in names), " behind s", "behind frames", "  frames/s", "log MB", "lost")
        )
    )
    step = max(1, round(seconds / 20))
    for count in recording.counts[step - 1 :: step]:
        at = int(count["seconds"])
        memory = [seen[min(at, len(seen) - 1)] / (1 << 20) for seen in (recording.memory[name] for name in names)]
        rate = sum(bus.get("frame_rate", 0.0) for bus in count["buses"])
        lost = sum(1 for note in recording.notes if "lost" in note["text"])
        print(
            f"{at:4}  " + "  ".join(f"{size:8.1f} MiB" for size in memory)
            + f"  {count['behind']:9.1f}  {count['behind_frames']:13}  {rate:10.0f}  {count['log_bytes'] / 1e6:6.1f}  {lost:4}"
        )  # fmt: skip


def report(recording, sent, processor, memory, took, killed, seconds):
    """Print the figures; return what is wrong."""
    end = recording.end
    for bus, result in sent.items():
        late_ms = 1e3 * result["late_most"]
        print(f"{bus}: sent {result['sent']} in {result['seconds']:.1f} s, its sender late by {late_ms:.1f} ms")
    for name, used in processor.items():
        more, share = growth(memory[name])
        now = memory[name][-1] / (1 << 20)
        print(f"{name}: {used / seconds:.2f} of a core, {now:.1f} MiB, grown by {more >> 10} KiB ({100 * share:.1f} %)")
    behind = max((count["behind"] for count in recording.counts), default=0.0)
    print(f"decoding behind {behind:.1f} s at most; finished {took:.1f} s after the end")
    print(f"killed {len(killed)}: {', '.join(killed) or 'none'}")
    print(f"findings {end['rules'] or 'none'}; lost: {end['lost']}; {end['bytes'] / 1e6:.1f} MB")
    wrong, seen = check(recording.log, sent)
    print(f"decoded {sum(seen.values())} frames: {seen}")
    # A short run is all beginning.
    if not killed and seconds >= STEADY:
        grown = [n for n, m in memory.items() if growth(m)[0] > 4 << 20 and growth(m)[1] > 0.2]
        wrong += [f"the memory of {name} has grown" for name in grown]
    if end["lost"]:
        wrong.append(f"lost: {end['ports']}")
    return wrong + [f"finding {rule}" for rule in end["rules"] if rule != "restarted"]


if __name__ == "__main__":
    sys.exit(main())
