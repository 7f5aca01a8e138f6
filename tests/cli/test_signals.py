"""Signals while a command reads: they end the reading, and are no damage of what is read."""

from __future__ import annotations

import contextlib
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from analyzer import cli
from analyzer.cli import main
from analyzer.cli.boundary import bounded
from analyzer.cli.signals import ENDING, Interrupt, handled


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


@pytest.mark.parametrize("number", ENDING)
def test_each_signal_ends_a_command_in_order(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that takes over no signal itself would leave its unfinished file behind."""
    left = []

    def run(parsed: object) -> int:
        try:
            signal.raise_signal(number)
        finally:
            left.append("the unfinished file is removed")
        return 0

    before = signal.getsignal(number)
    command = SimpleNamespace(__doc__="", add_arguments=lambda parser: None, run=run)
    monkeypatch.setattr(cli, "import_module", lambda name: command)
    assert main(["show"]) == 128 + number
    assert left
    assert signal.getsignal(number) is before


def test_a_signal_of_an_earlier_command_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(words: list[str]) -> int:
        raise KeyboardInterrupt

    def terminated(words: list[str]) -> int:
        with handled(signal.default_int_handler):
            signal.raise_signal(signal.SIGTERM)
        return 0

    assert [bounded(command, []) for command in (interrupted, terminated, interrupted)] == [130, 143, 130]


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="a system without SIGHUP")
def test_what_nohup_has_a_program_ignore_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupt() as interrupt:
            signal.raise_signal(signal.SIGHUP)
        assert not interrupt.asked
    finally:
        signal.signal(signal.SIGHUP, before)


#: A command that takes a signal for the end of its work, as most do, and says something on both streams.
_SAYS = """
import sys
from analyzer.cli.signals import handled
asked = []
def said(number, frame):
    asked.append(number)
    sys.stderr.write("it ends")
    sys.stderr.flush()
with handled(said):
    for stream in (sys.stdout, sys.stderr):
        stream.write("more than a pipe takes" * 100_000)
        stream.flush()
"""


@pytest.mark.skipif(not hasattr(select, "poll"), reason="a system that does not tell whether a pipe is full")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_reader_that_has_stalled_holds_up_no_end(number: int) -> None:
    """A write that waits for it is taken up again behind the handler."""
    with subprocess.Popen([sys.executable, "-c", _SAYS], stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        assert process.stdout is not None
        # It has begun. From here on nothing is read.
        assert process.stdout.read(1) == b"m"
        status = None
        # A signal that comes before the pipe is full changes nothing.
        for _ in range(30):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.send_signal(number)
                status = process.wait(2)
                break
        process.kill()
        assert status == 0
