"""Signals while a command reads: they end the reading, and are no damage of what is read."""

from __future__ import annotations

import signal
from collections.abc import Iterator

from analyzer.cli.signals import Interrupt


def test_a_signal_while_a_reader_waits_is_no_trouble_of_the_capture() -> None:
    def reader() -> Iterator[str]:
        yield "frame"
        try:
            signal.raise_signal(signal.SIGINT)
        except Exception:
            yield "the capture breaks off"
        yield "another frame"

    with Interrupt() as interrupt:
        assert list(interrupt.items(reader())) == ["frame"]
    assert interrupt.asked
