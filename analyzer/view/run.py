"""Running the view of a source on the terminal until it ends."""

from __future__ import annotations

from contextlib import nullcontext

from analyzer.view.app import ViewApp
from analyzer.view.source import ViewSource
from analyzer.view.terminal import EndingSignals, forgiving_terminal


def run(source: ViewSource, *, filter_text: str = "") -> str:
    """Run the view until it ends; return `quit`, `ended`, or why it could not go on. Raises what failed in it."""
    # The supervisor of a recording has its own handlers.
    with forgiving_terminal(), nullcontext() if source.live else EndingSignals() as signals:
        app = ViewApp(source, filter_text=filter_text, signals=signals)
        result = app.run()
    if app.failed is not None:
        raise app.failed
    return result or "quit"
