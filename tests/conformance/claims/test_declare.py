"""Declaring claims: cases, texts, ids, facts by case, and what `Probe.expect` refutes."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Certainty, Risk, Verb
from conformance.claim import Claim, Refuted, Theme
from conformance.claims.declare import Case, claim, commands, declared_in
from conformance.drives import make
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import Probe

MKS, LK = dialects.get("mks-rs485"), dialects.get("lk-rs485")


def _pairs(dialect):
    for speed in (1, 2):
        facts = {"at_best": Certainty.LIKELY} if speed == 2 else {}
        yield Case(dialect, dialect.by_verb[Verb.RUN_SPEED], {"speed": speed, "read": dialect.commands[0]}, facts)


SEEN: list[tuple[str, int]] = []


@claim(
    Theme.STATE, each=_pairs, name="{command}/x-{speed}", refuted_by="not {speed}", risks=lambda case: case["read"].all_risks
)
def _several(probe: Probe, speed: int, read: object) -> None:
    """{command} at {speed} beside
    {read}.

    A second paragraph is for readers of the code.
    """
    SEEN.append((read.name, speed))


@claim(Theme.STATE, each=commands(Verb.READ_ENABLED), refuted_by="x")
def _plain_one(probe: Probe) -> None:
    """It holds."""
    probe.expect(1, equal=2, refutes="one is not two")


def test_each_case_is_a_claim():
    first, second, third = declared_in(__name__, MKS)
    assert first.id == "mks-rs485/state/run_speed/x-1"
    assert first.statement == f"run_speed at 1 beside {MKS.commands[0].name}."
    assert (first.refuted_by, first.parameters) == ("not 1", {"speed": 1})
    assert (first.certainty, second.certainty) == (Certainty.CERTAIN, Certainty.LIKELY)
    assert first.commands == ("run_speed",)
    assert third.id == "mks-rs485/state/read_enabled/plain-one"


def test_a_dialect_without_the_command_has_no_claim_about_it():
    assert [c.id for c in declared_in(__name__, LK)] == ["lk-rs485/state/run_speed/x-1", "lk-rs485/state/run_speed/x-2"]


def test_a_check_gets_what_its_case_gives():
    SEEN.clear()
    verdicts = list(engine.run(declared_in(__name__, MKS), EmulatedRig(make.parse("mks-rs485@1,model=42D"))))
    assert [(MKS.commands[0].name, 1), (MKS.commands[0].name, 2)] == SEEN
    assert [v.outcome.value for v in verdicts] == ["confirmed", "confirmed", "refuted"]
    assert (verdicts[2].reason, verdicts[2].expected, verdicts[2].got) == ("one is not two", "2", "1")


def _probe() -> Probe:
    plain = Claim("mks-rs485/state/x", Theme.STATE, "mks-rs485", "x", "", "x", lambda probe: None, risks=frozenset({Risk.READ}))
    return EmulatedRig(make.parse("mks-rs485@1")).probe(plain)


@pytest.mark.parametrize(
    ("got", "conditions", "expected"),
    [
        (3.0, {"near": 5, "within": 1, "unit": "rpm"}, "5 rpm +-1"),
        (3, {"at_least": 4}, "at least 4"),
        (3, {"at_most": 2, "unit": "mA"}, "at most 2 mA"),
        (3, {"among": (1, 2)}, "1 or 2"),
        ([1, 2], {"equal": [1]}, "1"),
        ("a shaft that turns", {"holds": False, "expected": "rest"}, "rest"),
    ],
)
def test_expect_says_what_was_expected(got, conditions, expected):
    with pytest.raises(Refuted) as error:
        _probe().expect(got, refutes="it differs", **conditions)
    assert error.value.expected == expected
    assert error.value.key == "it differs"


def test_expect_passes_what_holds():
    probe = _probe()
    probe.expect(3.0, near=5, within=2, at_least=3, at_most=3, among=(3.0,), equal=3, holds=True, refutes="x")


def test_expect_needs_a_condition():
    with pytest.raises(ValueError, match="condition"):
        _probe().expect(1, refutes="x")


FIRST: list[str] = []


def _first(probe: Probe) -> None:
    FIRST.append(probe.claim.id)


def test_what_comes_first_is_called_before_each_check():
    calls: list[str] = []

    def _check(probe: Probe) -> None:
        """It holds."""
        calls.append(f"{len(FIRST)} before")

    _check.__module__ = "declared.first"
    claim(Theme.STATE, refuted_by="x", first=_first)(_check)
    FIRST.clear()
    (made,) = declared_in("declared.first", MKS)
    made.check(_probe())
    assert calls == ["1 before"]
