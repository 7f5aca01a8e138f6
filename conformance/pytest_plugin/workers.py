"""Workers of pytest-xdist: all tests on one real port run in one worker, since a port has one owner.

The groups of xdist itself (`--dist loadgroup`) are not used: they need changed names of tests, and some versions of pytest
do not let xdist change names.
"""

from __future__ import annotations

from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling  # type: ignore[import-untyped]

from conformance.pytest_plugin.plan import label
from conformance.suite import target as targets


class _ByPort(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """Hands out all tests of one port at once; tests of emulated drives one by one."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        super().__init__(config, log)
        found = targets.parse_all(config.getoption("servotap_drive"), config.getoption("servotap_on"))
        self._ports = {f"[{label(t, found)}:": t.port for t in found if not t.emulated}

    def _split_scope(self, nodeid: str) -> str:
        return next((port for label, port in self._ports.items() if label in nodeid), nodeid)


def scheduler(config: pytest.Config, log: Any) -> Any:
    """Return what hands out the tests of a run with real ports."""
    return _ByPort(config, log)
