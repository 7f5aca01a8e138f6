"""Covering arrays: all that is allowed together meets, no row breaks a rule, and the rows are few and always the same."""

from __future__ import annotations

from itertools import combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance.model import covering

QUICK = settings(max_examples=60, derandomize=True, database=None, deadline=None)


FACTORS = st.tuples(*[st.integers(1, 4)] * 5).map(
    lambda counts: {n: tuple(range(c)) for n, c in zip("abcde", counts, strict=True)}
)
FORBIDDEN = st.frozensets(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=5)


@QUICK
@given(FACTORS, FORBIDDEN, FORBIDDEN, st.integers(2, 3))
def test_all_that_is_allowed_together_meets(factors, first, second, strength):
    def found():
        return covering.rows(factors, lambda a, b: (a, b) not in first, lambda b, d: (b, d) not in second, strength=strength)

    def met(rows):
        return {(names, tuple(row[name] for name in names)) for row in rows for names in combinations(factors, strength)}

    every = [dict(zip(factors, levels, strict=True)) for levels in product(*factors.values())]
    every = [row for row in every if (row["a"], row["b"]) not in first and (row["b"], row["d"]) not in second]
    assert all(row in every for row in found())
    assert met(found()) == met(every)
    assert found() == found()


def test_the_rows_are_few():
    ten = dict.fromkeys("abcdefghij", (0, 1, 2))
    assert len(covering.rows(ten)) <= 25  # 59049 rows have all of them; no array of pairs has fewer than 14


def test_groups_meet_whole():
    factors = {"a": (0, 1, 2), "b": (0, 1), "c": (0, 1, 2), "d": (0, 1)}
    found = covering.rows(factors, together=[("a", "b", "c")])
    assert {(row["a"], row["b"], row["c"]) for row in found} == set(product((0, 1, 2), (0, 1), (0, 1, 2)))
    assert len(found) == 18


def test_the_first_level_is_taken_where_it_does_not_matter():
    assert covering.rows({"a": ("cheap", "dear")}, strength=1) == ({"a": "cheap"}, {"a": "dear"})
    assert covering.rows({"a": (1,), "b": (5, 6)}, lambda a, b: b > a) == ({"a": 1, "b": 5}, {"a": 1, "b": 6})


@QUICK
@given(FACTORS, FORBIDDEN)
def test_rows_by_cost_are_no_dearer_and_all_meets_as_before(factors, forbidden):
    def found(**how):
        return covering.rows(factors, lambda a, b: (a, b) not in forbidden, together=[("b", "c", "d")], **how)

    def cost(**row):
        return 1 + sum(row.values())

    def met(rows):
        groups = [*combinations(factors, 2), ("b", "c", "d")]
        return {(names, tuple(row[name] for name in names)) for row in rows for names in groups}

    plain, cheap = found(), found(cost=cost)
    assert met(cheap) == met(plain)
    assert all((row["a"], row["b"]) not in forbidden for row in cheap)
    assert len(cheap) <= len(plain)
    assert sum(cost(**row) for row in cheap) <= sum(cost(**row) for row in plain)
    assert cheap == found(cost=cost)


def test_what_only_fills_a_row_is_the_cheapest():
    factors = {"a": (0, 1), "b": ("dear", "cheap")}
    assert covering.rows(factors, strength=1, cost=lambda a, b: b == "dear")[1] == {"a": 1, "b": "cheap"}


def test_a_rule_about_no_factor_is_an_error():
    with pytest.raises(ValueError, match="a rule about z"):
        covering.rows({"a": (0, 1)}, lambda z: z)
