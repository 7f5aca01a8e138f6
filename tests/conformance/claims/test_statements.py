"""Coverage by sentence: each statement of a manual has claims that are there, or the reason why it has none."""

from __future__ import annotations

import fnmatch

import pytest

from analyzer import dialects
from conformance.suite import plan
from conformance.suite.target import parse


@pytest.fixture(scope="module")
def ids():
    """Return the ids of all claims of a dialect and all its models, without the dialect."""
    kept: dict[str, set[str]] = {}

    def of(name: str) -> set[str]:
        if name not in kept:
            models = dialects.get(name).models or ("",)
            targets = [parse(f"{name}@1" + (f",model={m}" if m else "")) for m in models]
            kept[name] = {c.id.partition("/")[2] for t in targets for c in plan.every_claim(t)}
        return kept[name]

    return of


WITH_STATEMENTS = [d for d in dialects.every() if d.statements]


@pytest.mark.parametrize("dialect", WITH_STATEMENTS, ids=lambda d: d.name)
def test_every_claim_that_a_statement_names_is_there(dialect, ids):
    lost = [(s.id, p) for s in dialect.statements for p in s.claims if not fnmatch.filter(ids(dialect.name), p)]
    assert lost == []


@pytest.mark.parametrize("dialect", WITH_STATEMENTS, ids=lambda d: d.name)
def test_every_command_has_statements(dialect):
    said = {s.section for s in dialect.statements}
    assert [(c.name, c.section) for c in dialect.commands if c.section not in said] == []
