"""The process of a tap for the supervisor of a recording: one reader that stores both directions of a bus."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from analyzer.live.children import READER_NICE, Child, MessageQueue


class TapChild(Child):
    """The process. `stems`: the spools of requests and of replies; it is known by the second.

    `ends`: descriptors of the pseudo-terminal, master and slave, which this process keeps. `options`: further words for it.
    """

    def __init__(
        self, folder: Path, stems: tuple[str, str], heard: MessageQueue, ends: tuple[int, int], options: Sequence[str] = ()
    ) -> None:
        # Nothing in the folder where the user happens to be is to be taken for a module.
        command = [sys.executable, "-P", "-m", "conformance.tap.process", str(folder), *stems]
        command += ["--terminal", *map(str, ends), *options]
        super().__init__(stems[1], command, heard, READER_NICE, handed=ends)
        self._stores = True

    def _hear(self, line: bytes) -> None:
        try:
            event = msgspec.json.decode(line, type=dict[str, Any])
        except msgspec.MsgspecError:
            return
        if event.get("event") == "lost":
            self.let_go()
        self._heard.put(("event", event.pop("stem", self.name), event))
