"""The terminal view: frames as they come, counts, bus load, findings, a plot, and the bytes of a frame explained.

    run_live(snapshots, mark=...)    a recording, from the snapshots of its supervisor (`live.SnapshotQueue`)
    run_capture(reading, ...)        a capture or a log

Both block. They need the main thread and the terminal; nothing else may print meanwhile.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING

from analyzer.errors import UsageError

if TYPE_CHECKING:
    from analyzer.cli.reading import OpenCapture
    from analyzer.view.live import SnapshotQueue


def require_terminal(command: str = "servotap view") -> None:
    """Raise UsageError where there is no terminal to show on, or textual is not installed."""
    # The view is drawn on standard error, for that is what textual does.
    streams = {"standard input": sys.stdin, "standard output": sys.stdout, "standard error": sys.stderr}
    others = [name for name, stream in streams.items() if stream is None or not stream.isatty()]
    if others:
        raise UsageError(
            f"{command} needs a terminal, which {' and '.join(others)} {'is' if len(others) == 1 else 'are'} not; "
            "servotap show prints the same frames as text"
        )
    try:
        import textual  # noqa: F401
    except ImportError:
        raise UsageError(f"{command} needs the package textual: pip install textual") from None


def run_live(snapshots: SnapshotQueue, *, mark: Callable[[str], str], log: str = "", model: str = "") -> str:
    """Show a recording until the user quits or the queue is closed; return `quit`, `ended`, or why it broke off.

    The recording goes on until its supervisor ends it. `mark` writes a note of the user into the log, in the main thread. It
    returns a message for the user or "", or raises ServotapError. `log`: the file to name; `model`: of the drives.
    """
    from analyzer.view.app import run
    from analyzer.view.live import LiveSource

    return run(LiveSource(snapshots, mark=mark, log=log, model=model))


def run_capture(reading: OpenCapture, *, filter_text: str = "") -> str:
    """Show a capture that is open until the user quits; return `quit`, or why it broke off."""
    from analyzer.view.app import run
    from analyzer.view.capture import CaptureSource

    with closing(CaptureSource(reading)) as source:
        return run(source, filter_text=filter_text)
