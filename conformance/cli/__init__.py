"""Commands that drive, send or test. They reach `servotap` by entry points of the group `servotap.commands`."""

from __future__ import annotations

#: What each command does, in one line. It stands here and not in the command's module, so that listing them imports nothing.
HELP: dict[str, str] = {
    "emulate": "emulate drives on a serial port, a TCP port or a CAN bus",
    "send": "send one frame to a drive, and show the reply decoded",
    "stop": "stop all drives of a bus, or those that are named, and prove that they stand",
    "scan": "find what answers on a bus: rates, dialects, addresses; reads only",
    "init": "write a profile, servotap.toml, with the drives that answer: names in place of endpoints",
    "replay": "send the requests of a recording again, at their times",
    "tap": "record what a program and its serial adapter say to each other",
    "check": "check recordings against the manual, by their traffic alone",
    "test": "test drives, real or emulated, against their manual",
    "rerun": "run the claim of a stored failure again: fixed, failing or flaky",
    "restore": "restore the settings that an interrupted run changed, from its journal",
}
