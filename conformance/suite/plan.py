"""A suite run: which claims on which targets, what may be done, and the verdicts as records.

`servotap test` and the pytest plugin both stand on this; neither holds a rule of its own about what runs.
"""

from __future__ import annotations

import contextlib
import fnmatch
import shlex
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec

from analyzer import __version__
from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.system.scratch import scratch_folder
from analyzer.values import near, quote, storable
from conformance import claims as registry
from conformance.claim import Claim, Outcome, Theme, Verdict
from conformance.drives import make
from conformance.gate.permissions import READS, Allowance
from conformance.motion import declared
from conformance.safety import settings
from conformance.safety.keeper import cannot_keep
from conformance.safety.stopping import MAY_MOVE
from conformance.suite import engine, order
from conformance.suite.processes import spread
from conformance.suite.record import RunRecord, VerdictRecord, record
from conformance.suite.rig import ClaimRig, lacking
from conformance.suite.target import Target
from conformance.talk.probe import ALL_QUIRKS

#: Claims that a worker takes at once.
_BATCH = 12


@dataclass(frozen=True)
class Plan:
    """What a run is to do.

    `allowance`: what may be sent, None: everything for emulated drives, reads alone for others. `claims`: ids or patterns
    (`*/shape/*`), empty: all. `themes`: empty: all. `seed` of Hypothesis and of emulated drives. `settings`: what to put
    back where a dialect cannot read it (by drive and field). `longest_run`: seconds of motion without an end. `traffic`:
    keep what went over the lines. `short`: the most telling claims, as many as fit into 90 s of a line. `accepted`: known
    quirks that refute nothing, by name, or `all`.
    """

    targets: tuple[Target, ...]
    allowance: Allowance | None = None
    claims: tuple[str, ...] = ()
    themes: tuple[str, ...] = ()
    seed: int = 0
    settings: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    journal: str = ""
    cut_power: str = ""
    longest_run: float = 30.0
    dry_run: bool = False
    traffic: bool = False
    short: bool = False
    accepted: tuple[str, ...] = ()

    def selected(self, target: Target) -> list[Claim]:
        """Return the claims about a target, in the order in which they run. Raises UsageError for a theme that there is not.

        On a real line what teaches most in a second comes first; time on an emulated one costs nothing.
        """
        wanted = self._in_order(target)
        if not self.short:
            return wanted
        alone = self.allowance is not None and self.allowance.alone
        before = order.start_seconds(target.dialect.name, target.rate, alone=alone and not target.emulated)
        before += sum(order.seconds(c, target.rate) for c in proving_claims(self, target))
        can_run = [c for c in wanted if not self._lacking(c, target)]
        return list(order.fitting(can_run, target.rate, order.SHORT_SECONDS - order.ENDING_SECONDS - before))

    def in_time(self, target: Target, began_ns: int, now_ns: Callable[[], int]) -> Iterator[Claim]:
        """Yield the claims of a short run on a real line as long as there is time for them, by the clock of its line."""
        first_ns = now_ns()
        within = order.SHORT_SECONDS - order.ENDING_SECONDS - (first_ns - began_ns) / 1e9
        can_run = (c for c in self._in_order(target) if not self._lacking(c, target))
        yield from order.fitting(can_run, target.rate, within, lambda: (now_ns() - first_ns) / 1e9)

    def _in_order(self, target: Target) -> list[Claim]:
        _check_themes(self.themes)
        wanted = [c for c in every_claim(target) if self._wants(c)]
        return order.ordered(wanted, target.rate) if self.short or not target.emulated else wanted

    def seconds(self, target: Target) -> dict[str, float]:
        """Return how long each claim will take, by id: on a real line what was measured, each alike on an emulated one."""
        if target.emulated:
            return {claim.id: 1.0 for claim in self.selected(target)}
        return {c.id: 0.0 if self._lacking(c, target) else order.seconds(c, target.rate) for c in self.selected(target)}

    def left_out(self, target: Target) -> Counter[str]:
        """Return what the user could give so that a short run has more claims to choose from, and how many claims need it."""
        if not self.short or target.emulated:
            return Counter()
        every = [c for c in self._in_order(target) if not c.emulated and not c.by_name]
        return Counter(lacks for c in every if (lacks := self._lacking(c, target)))

    def _lacking(self, claim: Claim, target: Target) -> str:
        """Return what a claim needs that the options do not give, as far as is known before the run, or nothing."""
        if target.emulated:
            return ""
        given = self.allowance or Allowance(READS)
        known = settings.known(target.dialect, f"{target.dialect.name}@{target.address}", self.settings)
        lacks = lacking(claim, target.model, given.risks, alone=given.alone, named=self.claims)
        return lacks or cannot_keep(target.dialect, claim.settings, known)

    def _wants(self, claim: Claim) -> bool:
        if self.themes and claim.theme.value not in self.themes:
            return False
        return not self.claims or any(fnmatch.fnmatchcase(claim.id, pattern) for pattern in self.claims)

    def run_record(self, started_at: str, seconds: float, words: Sequence[str], notes: Sequence[str] = ()) -> RunRecord:
        """Return what a run of it was. `words`: the command line."""
        allowance = self.allowance
        return RunRecord(
            targets=tuple(t.text for t in self.targets),
            on=tuple(t.on for t in self.targets),
            version=__version__,
            started_at=started_at,
            seconds=round(seconds, 3),
            seed=self.seed,
            allowed=() if allowance is None else tuple(sorted(risk.value for risk in allowance.risks)),
            bounds={} if allowance is None else allowance.described(),
            command=storable(shlex.join(words)),
            notes=tuple(notes),
        )

    def check(self) -> None:
        """Raise UsageError for patterns that name no claim of any target, and for quirks that there are not."""
        quirks = [*(q.name for q in make.every_quirk()), ALL_QUIRKS]
        for name in self.accepted:
            if name not in quirks:
                raise UsageError(f"no quirk {quote(name)}{near(name, quirks)} (see servotap emulate --list-quirks)")
        ids = [c.id for target in self.targets for c in every_claim(target)]
        for pattern in self.claims:
            if not any(fnmatch.fnmatchcase(i, pattern) for i in ids):
                raise UsageError(f"no claim {quote(pattern)}{near(pattern, ids)} (servotap test --list lists all)")


def _check_themes(themes: Sequence[str]) -> None:
    known = [theme.value for theme in Theme]
    for theme in themes:
        if theme not in known:
            raise UsageError(f"no theme {quote(theme)}, expected one of {', '.join(known)}")


#: Dialects as their models speak them: claims are kept with the dialect they were made for.
_dialects: dict[tuple[str, str], Dialect] = {}


def _dialect(dialect: Dialect, model: str) -> Dialect:
    key = (dialect.name, model)
    if key not in _dialects:
        _dialects[key] = dialect.for_model(model) if model else dialect
    return _dialects[key]


def every_claim(target: Target) -> tuple[Claim, ...]:
    """Return all claims about a target's dialect and model, in order."""
    return registry.every(_dialect(target.dialect, target.model))


def open_rig(plan: Plan, target: Target) -> ClaimRig:
    """Return the rig of a target. Raises UsageError where its line cannot be opened or it cannot be tested as asked."""
    if target.specification is not None:
        from conformance.suite.rig_emulated import EmulatedRig

        rig: ClaimRig = EmulatedRig(target.specification, seed=plan.seed, allowance=plan.allowance)
    else:
        from conformance.suite.rig_real import RealRig

        rig = RealRig(plan, target)
    rig.accepted = frozenset(plan.accepted)
    return rig


def run(plan: Plan, jobs: int = 1) -> Generator[VerdictRecord]:
    """Run a plan and yield its verdicts as they come; with several jobs, in any order.

    Emulated drives are spread over `jobs` processes; drives on real lines run here, one after the other, for a line has
    one owner. Raises LineLost, NotStopped.
    """
    emulated = [t for t in plan.targets if t.emulated]
    for target in plan.targets:
        if not target.emulated:
            yield from _run_target(plan, target)
    if jobs > 1 and emulated:
        with _one_budget(plan) as shared:
            yield from _spread(shared, emulated, jobs)
        return
    for target in emulated:
        yield from _run_target(plan, target)


@contextlib.contextmanager
def _one_budget(plan: Plan) -> Iterator[Plan]:
    """Return a plan whose budget several processes spend together, by a file."""
    allowance = plan.allowance
    if allowance is None or allowance.budget.path is not None:
        yield plan
        return
    with scratch_folder() as folder:
        path = folder / "budget.json"
        path.write_bytes(msgspec.json.encode(allowance.budget.spent))
        yield replace(plan, allowance=replace(allowance, budget=replace(allowance.budget, path=path)))


def proving_claims(plan: Plan, target: Target) -> list[Claim]:
    """Return the claims about the reads on which safety rests, where something may move a real drive."""
    if target.emulated or not (plan.allowance or Allowance(READS)).risks & MAY_MOVE:
        return []
    reads = declared.proving_reads(target.dialect)
    return [c for c in every_claim(target) if c.theme is Theme.SHAPE and reads.intersection(c.commands) and c.risks <= READS]


def verdicts(plan: Plan, target: Target, selected: Sequence[Claim], rig: ClaimRig) -> Iterator[Verdict]:
    """Yield the verdicts of the selected claims, and those of claims about safety's reads that are refuted."""
    proving = proving_claims(plan, target) if any(c.risks & MAY_MOVE for c in selected) else []
    for verdict in engine.prove_reads(proving, rig):
        if verdict.claim in selected or verdict.outcome is Outcome.REFUTED:
            yield verdict
    chosen = plan.in_time(target, rig.began_ns, rig.gate.now_ns) if plan.short and not target.emulated else selected
    yield from engine.run((c for c in chosen if c not in proving), rig)


def _run_target(plan: Plan, target: Target) -> Iterator[VerdictRecord]:
    selected = plan.selected(target)
    rig = open_rig(plan, target)
    try:
        for verdict in verdicts(plan, target, selected, rig):
            yield record(verdict, target.text, firmware=rig.firmware, traffic=plan.traffic, noise=rig.noise.figures)
    finally:
        rig.close()


# --- several processes ------------------------------------------------------------------------------------------------

_plan: Plan | None = None


def _begin(plan: Plan) -> None:
    global _plan
    _plan = plan


def _batch(work: tuple[int, tuple[str, ...]]) -> list[VerdictRecord]:
    assert _plan is not None  # every worker begins with `_begin`
    target = _plan.targets[work[0]]
    wanted = set(work[1])
    rig = open_rig(_plan, target)
    try:
        found = [c for c in every_claim(target) if c.id in wanted]
        return [record(v, target.text, traffic=_plan.traffic, noise=rig.noise.figures) for v in engine.run(found, rig)]
    finally:
        rig.close()


def _spread(plan: Plan, targets: Sequence[Target], jobs: int) -> Iterator[VerdictRecord]:
    work: list[tuple[int, tuple[str, ...]]] = []
    for index, target in enumerate(plan.targets):
        if target in targets:
            ids = [claim.id for claim in plan.selected(target)]
            work += [(index, tuple(ids[at : at + _BATCH])) for at in range(0, len(ids), _BATCH)]
    for records in spread(work, _batch, jobs, _begin, plan):
        yield from records
