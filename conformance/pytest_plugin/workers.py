"""Workers of pytest-xdist: all tests on one real port run in one worker, since a port has one owner.

The groups of xdist itself (`--dist loadgroup`) are not used: they need changed names of tests, and some versions of pytest
do not let xdist change names.
"""

from __future__ import annotations

import re
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling  # type: ignore[import-untyped]

from conformance.pytest_plugin.plan import label
from conformance.suite import target as targets


class ByPort(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """Hands out all tests of one port at once; tests of emulated drives one by one."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        super().__init__(config, log)
        found = targets.parse_all(config.getoption("servotap_drive"), config.getoption("servotap_on"))
        named = {re.escape(label(t, found)): t.port for t in found if not t.emulated}
        # In the ids of the suite a claim follows; in those of other tests another parameter may stand before or behind.
        self._ports = {re.compile(rf"[\[-]{text}[\]:-]"): port for text, port in named.items()}

    def _split_scope(self, nodeid: str) -> str:
        return next((port for pattern, port in self._ports.items() if pattern.search(nodeid)), nodeid)
