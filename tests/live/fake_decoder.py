"""A decoding process that decodes nothing: it follows the spools and copies their records into the log, as lines of JSON.

For tests of what stands before decoding. It goes on where a killed one was, ends when CONTROL holds `end`, or when its
supervisor has gone and the readers have ended.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import sys
import time
from pathlib import Path

from analyzer.live import config
from analyzer.live.lock import RUNNING, Lock
from analyzer.live.snapshot import BusCounts, Snapshot
from analyzer.live.snapshot_pipe import SnapshotWriter
from analyzer.live.spool import Kind, SpoolReader

#: How long readers whose supervisor has gone may take to end.
PATIENCE_S = 3.0


def main() -> int:
    folder = Path(sys.argv[1])
    recording = config.load(folder)
    lock = Lock(folder, RUNNING, shared=True)
    feed = SnapshotWriter(int(sys.argv[sys.argv.index("--feed") + 1]))
    log = Path(recording.log)
    done = [json.loads(line) for line in log.read_text().splitlines() if line.endswith("}")] if log.exists() else []
    starts = {line["stem"]: (line["segment"], line["end"]) for line in done}
    buses = {port.stem: port.bus for port in recording.ports}
    counts = {bus: BusCounts(bus) for bus in buses.values()}
    spools = {stem: SpoolReader(folder, stem, starts.get(stem)) for stem in [config.CONTROL, *buses]}
    ended = orphaned = False
    closed: set[str] = set()
    number = 0
    orphaned_at = 0.0
    with log.open("a") as out:
        while True:
            found = 0
            for stem, spool in spools.items():
                for record in spool.read():
                    found += 1
                    line = {
                        "stem": stem, "kind": record.kind, "t_ns": record.t_ns, "before": record.before,
                        "data": record.data.hex(), "segment": record.segment, "end": record.end,
                    }  # fmt: skip
                    if record.kind == Kind.EVENT:
                        event = record.event
                        line["event"] = event
                        ended |= stem == config.CONTROL and event["event"] == "end"
                        if event["event"] == "closed":
                            closed.add(stem)
                        if event["event"] in ("open", "back", "note"):
                            closed.discard(stem)
                    elif stem in buses:
                        count = counts[buses[stem]]
                        count.frames += 1
                        count.bytes += len(record.data)
                    out.write(json.dumps(line) + "\n")
                spool.drop_before(spool.position[0])
            out.flush()
            number += 1
            if ended and not found:
                break
            feed.offer(
                Snapshot(t_ns=time.time_ns(), number=number, buses=list(counts.values()), log=str(log), log_bytes=out.tell())
            )
            ready, _, _ = select.select([] if orphaned else [0], [], [], 0.05)
            if ready and not os.read(0, 1):
                orphaned, orphaned_at = True, time.monotonic()
            if orphaned and not found and (closed >= buses.keys() or time.monotonic() - orphaned_at > PATIENCE_S):
                break
    feed.offer(
        Snapshot(t_ns=time.time_ns(), number=number + 1, buses=list(counts.values()), log=str(log), log_bytes=1, ended=True)
    )
    feed.close()
    lock.close()
    shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
