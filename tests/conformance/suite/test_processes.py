"""Processes that share a run end with it, also where one of them dies."""

from __future__ import annotations

import multiprocessing
import os
import signal

import pytest

from conformance.claim import RigFault
from conformance.suite.processes import spread

DEADLY = 3


def nothing() -> None: ...


def ended(how: int) -> None:
    raise SystemExit(how)


def work(number: int) -> int:
    if number == DEADLY:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def test_results_come_in_order():
    assert list(spread((2, 1, 5, 4), work, 2, nothing)) == [4, 2, 10, 8]


@pytest.mark.parametrize(("pieces", "begin", "about"), [((1, DEADLY, 2), nothing, ()), ((1, 2), ended, (9,))])
def test_a_process_that_dies_ends_the_run(pieces, begin, about):
    with pytest.raises(RigFault, match="a process of this run died"):
        list(spread(pieces, work, 2, begin, *about))
    assert not multiprocessing.active_children()


def test_what_the_work_raises_is_raised():
    with pytest.raises(TypeError, match="unsupported operand"):
        list(spread((1, None), work, 2, nothing))


def test_a_run_that_is_left_leaves_no_process():
    results = spread(tuple(range(10, 40)), work, 2, nothing)
    next(results)
    results.close()
    assert not multiprocessing.active_children()
