"""An attempt in which the line damaged something is made anew, from where the shaft rests then."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from conformance import claims as registry
from conformance.claim import Inconclusive
from conformance.drives import make
from conformance.motion import motion
from conformance.motion.attempts import anew, undamaged
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import SECOND_NS


@pytest.fixture
def probe():
    rig = EmulatedRig(make.parse("mks-rs485@1,work_mode=sr_vfoc"))
    return rig.probe(next(iter(registry.every(rig.dialect))))


# What becomes of each attempt: whether the line damages something, and whether nothing can be said.
@pytest.mark.parametrize(
    ("attempts", "made"),
    [
        ([(False, False)], 1),
        ([(True, False), (False, False)], 2),
        ([(True, True), (False, False)], 2),
        ([(True, False), (True, True), (True, False)], 3),
    ],
)
def test_what_the_last_attempt_shows_is_returned(probe, attempts, made):
    rests = []

    def attempt(probe, turns, rest):
        motion.run_at(probe, 60)
        probe.wait(SECOND_NS // 2)
        rests.append(rest.value)
        damages, fails = attempts[len(rests) - 1]
        probe.traffic += [SimpleNamespace(damaged=True, command=None, unanswered=False)] * damages
        if fails:
            raise Inconclusive("not answered")
        return turns, len(rests)

    assert undamaged(probe, attempt, 7, rest=motion.position(probe)) == (7, made)
    # Each begins where the shaft came to rest behind the one before.
    assert rests == sorted(set(rests))


@pytest.mark.parametrize(("damages", "made"), [(False, 1), (True, 3)])
def test_what_the_last_attempt_raises_is_raised(probe, damages, made):
    tried = []

    def attempt(probe):
        tried.append(probe.traffic.append(SimpleNamespace(damaged=False, command=None, unanswered=damages)))
        raise Inconclusive("not answered")

    with pytest.raises(Inconclusive):
        undamaged(probe, attempt)
    assert len(tried) == made


def test_a_function_that_makes_attempts_keeps_its_name_and_what_it_is_given(probe):
    tried = []

    @anew
    def turned(probe, turns, *, way):
        """Turn the shaft."""
        tried.append((turns, way))
        probe.traffic += [SimpleNamespace(damaged=True, command=None, unanswered=False)] * (len(tried) == 1)
        return turns * way

    assert turned(probe, 3, way=-1) == -3
    assert tried == [(3, -1)] * 2
    # A recording is known by the name of what made it.
    assert turned.__name__ == "turned"


@pytest.mark.parametrize(("silences", "made"), [(True, 1), (False, 3)])
def test_a_silence_that_the_claim_has_set_is_no_loss(probe, silences, made):
    if silences:
        probe.ask("set_respond", {"respond": 0, "active": 0})
    tried = []

    def attempt(probe):
        tried.append(probe.traffic.append(SimpleNamespace(damaged=False, command=None, unanswered=True)))

    undamaged(probe, attempt)
    assert len(tried) == made
