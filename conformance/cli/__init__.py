"""Commands that drive, send or test. They reach `servotap` by entry points of the group `servotap.commands`."""

from __future__ import annotations

#: What each command does, in one line. It stands here and not beside the command, so that listing them imports nothing.
HELP: dict[str, str] = {
    "emulate": "emulated drives on a serial port, a TCP port or a CAN bus",
}
