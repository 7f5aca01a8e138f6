"""Signals while a motor may turn: they end a run as Ctrl-C does, and break into neither a stop nor half a message."""

from __future__ import annotations

import signal
import threading

import pytest

from conformance.safety.signals import as_interrupt, deferred, undisturbed

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("number", SIGNALS)
def test_every_signal_that_ends_a_program_is_a_ctrl_c(number: int):
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), as_interrupt():
        signal.raise_signal(number)
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", SIGNALS)
def test_none_breaks_in_while_undisturbed(number: int):
    with undisturbed():
        signal.raise_signal(number)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_deferred_signal_comes_when_all_is_done(number: int):
    done = []

    def work() -> None:
        with deferred():
            signal.raise_signal(number)
            done.append("rest")

    with pytest.raises(KeyboardInterrupt), as_interrupt():
        work()
    assert done == ["rest"]


def test_a_deferred_signal_comes_after_a_failure_too():
    def work() -> None:
        with deferred():
            signal.raise_signal(signal.SIGTERM)
            raise OSError("the pipe broke")

    with pytest.raises(KeyboardInterrupt), as_interrupt():
        work()


def test_an_ignored_signal_stays_ignored():
    with undisturbed(), deferred():
        signal.raise_signal(signal.SIGTERM)


def test_another_thread_takes_nothing_over():
    entered = []

    def work() -> None:
        with deferred():
            entered.append(signal.getsignal(signal.SIGINT))

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert entered == [before]
