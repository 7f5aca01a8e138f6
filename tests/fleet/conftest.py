"""Captures of a hall, and what stands in a lake of them."""

from __future__ import annotations

import pytest

from tests.fleet.lakes import hall, ingest, lake, rows


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return hall(tmp_path_factory.mktemp("hall"), 4)


@pytest.fixture(scope="module")
def clean(captures, tmp_path_factory):
    """What stands in a lake after a run in which nothing went wrong."""
    made = lake(tmp_path_factory.mktemp("clean") / "lake")
    ingest(made, captures)
    return rows(made)
