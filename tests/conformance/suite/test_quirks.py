"""Quirks: with each of them, accepted, nothing is refuted, and exactly the claims that name it change their verdict.

All quirks, over all themes. The claims that name a quirk are run in full; of all others, a sample that differs from quirk
to quirk. Everything at once: python -m tests.conformance.quirk_runs
"""

from __future__ import annotations

import json
import zlib
from functools import cache

import pytest

from analyzer import dialects
from analyzer.records import Junk, JunkReason
from conformance import claims as registry
from conformance.claim import Outcome
from conformance.drives import make
from conformance.suite import engine
from conformance.suite.engine import Verdict
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.exchange import Exchange
from conformance.talk.no_checksum import BareReplies
from tests.conformance import golden
from tests.conformance.quirk_runs import UNSEEN, changes, pairs, run

#: Of the claims that do not name a quirk, each of so many is run with it.
_SAMPLE = 160
#: Claims that a drive as its manual has it does not confirm; that it confirms all others is proved by test_conforming.
_UNCONFIRMED = {kept["id"] for kept in map(json.loads, golden.kept("verdicts")) if "id" in kept}
_known: dict[str, Outcome] = {}


@cache
def plain(dialect: str) -> EmulatedRig:
    """Return the rig without a quirk; one for all, so that each motion is recorded once."""
    return EmulatedRig(make.parse(f"{dialect}@1"))


def before(verdict: Verdict) -> Outcome:
    """Return what a claim comes to without a quirk; where that is proved anyway, it is not run again."""
    claim = verdict.claim
    if verdict.outcome is Outcome.CONFIRMED and claim.id not in _UNCONFIRMED:
        return Outcome.CONFIRMED
    if claim.id not in _known:
        _known[claim.id] = engine.run_claim(claim, plain(claim.dialect)).outcome
    return _known[claim.id]


@pytest.mark.parametrize(("dialect", "quirk"), list(pairs()))
def test_a_quirk_changes_the_claims_that_name_it_and_no_others(dialect, quirk):
    # By their names, so that a new claim does not change the sample of the others.
    wanted = [
        c
        for c in registry.every(plain(dialect).dialect)
        if quirk in c.quirks or not zlib.crc32(f"{quirk} {c.id}".encode()) % _SAMPLE
    ]
    found = changes(dialect, quirk, wanted, before)
    assert (found.refuted, found.inconclusive, found.unnamed, found.unmoved) == ([], [], [], [])


@pytest.mark.parametrize(("dialect", "quirk"), list(pairs()))
def test_every_quirk_is_named_by_a_claim(dialect, quirk):
    named = [c for c in registry.every(EmulatedRig(make.parse(f"{dialect}@1")).dialect) if quirk in c.quirks]
    assert named or (dialect, quirk) in UNSEEN


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-modbus", "mks-can", "lk-rs485"])
def test_a_claim_names_only_quirks_that_drives_of_its_dialect_have(dialect):
    had = {quirk.name for quirk in make.every_quirk() if dialect in quirk.dialects}
    for claim in registry.every(EmulatedRig(make.parse(f"{dialect}@1")).dialect):
        assert set(claim.quirks) <= had, claim.id


def test_a_reply_without_checksum_is_read_and_shown_as_one():
    rig = EmulatedRig(make.parse("mks-rs485@1,quirk=no-checksum"))
    claim = next(c for c in registry.every(rig.dialect) if c.id == "mks-rs485/motion/read_speed/at-rest")
    probe = rig.probe(claim)
    exchange = probe.ask("read_position")
    assert exchange.answers[0].bare
    assert exchange.answers[0].values == {"position": 0}
    assert exchange.answers[0].data == bytes.fromhex("FB 01 31 00 00 00 00 00 00")
    assert "NO CHECKSUM" in "\n".join(exchange.lines())


@pytest.mark.parametrize("drive", ["mks-rs485@1,fault=half-frame", "mks-modbus@1,fault=checksum-missing"])
def test_other_damage_is_not_taken_for_a_missing_checksum(drive):
    rig = EmulatedRig(make.parse(drive))
    claim = next(c for c in registry.every(rig.dialect) if c.id.endswith("/motion/read_speed/at-rest"))
    exchange = rig.probe(claim).ask("read_position")
    assert not any(answer.bare for answer in exchange.answers)


@pytest.mark.parametrize(("status", "read"), [(0xC2, False), (2, True)])
def test_the_rest_of_two_frames_that_collided_is_no_reply_without_checksum(status, read):
    """The told end of a move ran into a request: `FB 01 F4 C2` came in place of `FB 01 F4 02 F2`."""
    junk = Junk("bus", 0, 0, 0, bytes((0xFB, 1, 0xF4, status)), JunkReason.TRUNCATED)
    found = BareReplies(dialects.get("mks-rs485")).of_junk(junk, Exchange(None, 0))
    assert (found is not None) is read


@pytest.mark.parametrize(
    ("accepted", "outcome"),
    [
        ("new-address-answers", Outcome.OBSERVED),
        ("all", Outcome.OBSERVED),
        ("settling", Outcome.REFUTED),
        ("", Outcome.REFUTED),
    ],
)
def test_a_known_quirk_is_refuted_and_named_unless_it_is_accepted(accepted, outcome):
    every = registry.every(EmulatedRig(make.parse("mks-rs485@1")).dialect)
    wanted = [c for c in every if c.id.endswith("addressing/set_address/moves")]
    (only,) = run("mks-rs485@1,quirk=new-address-answers", wanted, accepted).values()
    assert only.outcome is outcome
    assert only.quirks == ("new-address-answers",)
    assert "new-address-answers" in only.reason
    assert ("accepted" in only.reason) is (outcome is Outcome.OBSERVED)


_TOLD_EARLY = "motion/stop_speed/told-when-standing"


@pytest.mark.parametrize(
    ("change", "accepted", "outcome", "quirks"),
    [
        # Replies that are late let a stop look as if it were told early.
        ("quirk=slow-replies-in-motion", "all", Outcome.OBSERVED, ("slow-replies-in-motion",)),
        ("quirk=slow-replies-in-motion", "", Outcome.REFUTED, ("slow-replies-in-motion",)),
        # A drive without the quirk that tells it early lies, also with every quirk accepted.
        ("fault=stop-completion-early", "all", Outcome.REFUTED, ()),
        ("fault=stop-completion-early,quirk=settling", "all", Outcome.REFUTED, ()),
    ],
)
def test_a_quirk_explains_a_claim_that_does_not_name_it_on_a_drive_that_has_it(change, accepted, outcome, quirks):
    dialect = "mks-can" if "settling" in change else "mks-rs485"
    wanted = [c for c in registry.every(plain(dialect).dialect) if c.id.endswith(_TOLD_EARLY)]
    (only,) = run(f"{dialect}@1,{change}", wanted, accepted).values()
    assert (only.outcome, only.quirks) == (outcome, quirks)


def test_a_quirk_that_the_drive_has_shown_explains_no_other_lie():
    rig = EmulatedRig(make.parse("mks-rs485@1,quirk=slow-replies-in-motion,fault=move-pulses-doubled"))
    rig.accepted = frozenset({"all"})
    (wanted,) = (c for c in registry.every(rig.dialect) if c.id.endswith("motion/move_relative_pulses/crossed-ends"))
    verdict = engine.run_claim(wanted, rig)
    assert rig.shown == {"slow-replies-in-motion"}
    assert (verdict.outcome, verdict.quirks) == (Outcome.REFUTED, ())


@pytest.mark.parametrize(
    ("drive", "name"),
    [
        ("mks-rs485@1,quirk=second-reply", "addressing/group/read"),
        ("mks-rs485@1,quirk=second-reply", "addressing/group/outcomes"),
        ("mks-rs485@1,quirk=hasty-writes-dropped", "resilience/settings/stopped"),
        ("mks-modbus@1,quirk=hasty-writes-dropped", "ranges/set_work_mode/work_mode/unlisted"),
    ],
)
def test_what_a_setting_is_followed_by_leaves_drives_the_time_they_need(drive, name):
    wanted = [c for c in registry.every(plain(drive.split("@")[0]).dialect) if c.id.endswith(name)]
    (only,) = run(drive, wanted, "").values()
    assert only.outcome is Outcome.CONFIRMED
