"""A Hypothesis state machine for each dialect: random sequences of allowed steps, compared with a model after each step.

    check(probe, "mixed")                  the check of a claim: draw, run, and refute with the shortest failing sequence
    machine(probe, "mixed", recorder)      the RuleBasedStateMachine itself
    replay(probe, steps)                   the same steps again, on any drive

The rules are the kinds of steps of the dialect's session (`mks`, `lk`) whose risks are allowed. Their values are drawn within
the bounds of the gate. A run is derandomised: the same seed draws the same sequences.

A failing sequence is shortened: steps are removed, and the rest runs on a new emulated drive, as long as it fails in the same
way. So the time for shortening is bounded. On hardware the sequence is reported in full.

Rules kept here:
- All sequences of a run go to one drive, each from the state that `Session.begin` sets up.
- A step that raises Inconclusive ends the run: another claim judges its cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hypothesis import HealthCheck, Phase, Verbosity, seed, settings
from hypothesis.errors import FlakyStrategyDefinition
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from hypothesis.strategies import runner

from analyzer.catalogue import Dialect, Risk
from conformance.claim import Inconclusive, NotRun, Refuted
from conformance.model.lk import LkSession
from conformance.model.mks import MksSession
from conformance.model.session import Session, Step, StepKind

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Sequences and steps of a run: on emulated drives, and on real ones, where each takes seconds.
EXAMPLES, STEPS = 6, 24
REAL_EXAMPLES, REAL_STEPS = 2, 10
#: How many shorter sequences are tried at most.
SHORTER = 60


#: The kind of session of each family of drives.
_SESSIONS: Mapping[str, type[Session]] = {"mks": MksSession, "lk": LkSession}


def session_of(dialect: Dialect) -> type[Session]:
    """Return the kind of session that a dialect's drives have. Raises KeyError where there is none."""
    return _SESSIONS[dialect.family]


def variants(dialect: Dialect) -> Mapping[str, tuple[str, ...]]:
    """Return the variants of a dialect's machine: which kinds of steps each draws, by name."""
    return {name: tuple(kinds.split()) for name, kinds in session_of(dialect).VARIANTS.items()}


def kinds(dialect: Dialect, variant: str) -> list[StepKind]:
    """Return the kinds of steps of a variant."""
    known = session_of(dialect).KINDS
    return [known[name] for name in variants(dialect)[variant]]


@dataclass
class Recorder:
    """What came of a run: how many sequences and steps were done (`before` the present one), the first failure, its steps."""

    sequences: int = 0
    steps: int = 0
    before: int = 0
    failure: Refuted | Inconclusive | None = None
    failed: list[Step] = field(default_factory=list)


# --- the machine ------------------------------------------------------------------------------------------------------


def machine(probe: Probe, variant: str, recorder: Recorder) -> type[RuleBasedStateMachine]:
    """Return the state machine of a drive's dialect: one rule for each kind of step whose risks are allowed."""

    def start(self: Any) -> None:
        RuleBasedStateMachine.__init__(self)
        recorder.sequences += 1
        recorder.before = recorder.steps
        self.session = session_of(probe.dialect)(probe)

    def teardown(self: Any) -> None:
        if recorder.failure is None:
            self.session.end()

    body: dict[str, Any] = {"__init__": start, "teardown": teardown}
    for number, kind in enumerate(kinds(probe.dialect, variant)):
        if kind.risks <= probe.rig.allowed | {Risk.READ}:
            body[f"step_{number:02}_{kind.name}"] = _rule(kind, recorder)
    return type(f"{variant.title()}Machine", (RuleBasedStateMachine,), body)


def _rule(kind: StepKind, recorder: Recorder) -> Any:
    def act(self: Any, values: dict[str, int]) -> None:
        try:
            self.session.do(Step(kind.name, values))
            recorder.steps = self.session.done + recorder.before
        except (Refuted, Inconclusive) as error:
            if recorder.failure is None:
                recorder.failure, recorder.failed = error, list(self.session.steps)
            raise

    drawn = runner().flatmap(lambda self: kind.values(self.session))
    return precondition(lambda self: kind.possible(self.session))(rule(values=drawn)(act))


def run(probe: Probe, variant: str) -> Recorder:
    """Run the machine and return what came of it; it stops at the first failure.

    Raises what is neither a refutation nor Inconclusive (a lost port).
    """
    recorder = Recorder()
    real = probe.drive is None
    chosen = seed(getattr(probe.rig, "seed", 0))(machine(probe, variant, recorder))
    try:
        run_state_machine_as_test(
            chosen,
            settings=settings(
                max_examples=REAL_EXAMPLES if real else EXAMPLES,
                stateful_step_count=REAL_STEPS if real else STEPS,
                phases=(Phase.generate,),
                database=None,
                # The seed alone decides the draws; a profile of Hypothesis must not change them.
                derandomize=False,
                deadline=None,
                print_blob=False,
                report_multiple_bugs=False,
                verbosity=Verbosity.quiet,
                suppress_health_check=list(HealthCheck),
            ),
        )
    except (Refuted, Inconclusive) as error:
        recorder.failure = recorder.failure or error
    except FlakyStrategyDefinition:
        # The same real drive stands elsewhere when a sequence is repeated, so other values are drawn. The steps until then
        # were compared.
        if recorder.failure is None and not (real and recorder.steps):
            raise
    except Exception:
        # Hypothesis repeats a failure and may find that it does not come again: the first one is what was seen.
        if recorder.failure is None:
            raise
    return recorder


# --- failures ---------------------------------------------------------------------------------------------------------


def replay(probe: Probe, steps: Sequence[Step]) -> Refuted | None:
    """Do steps again from the beginning; return what refutes the drive, None where nothing does.

    Raises Inconclusive where the steps cannot be done.
    """
    try:
        session = session_of(probe.dialect)(probe)
        for step in steps:
            session.do(step)
    except Refuted as error:
        return error
    session.end()
    return None


def shortened(probe: Probe, steps: Sequence[Step], key: str) -> tuple[list[Step], Refuted | None]:
    """Return the shortest sequence found that refutes a new emulated drive in the same way, and how; None: none does.

    Steps are taken out in halves, quarters and so on, then one by one.
    """
    budget = SHORTER

    def fails(candidate: Sequence[Step]) -> Refuted | None:
        nonlocal budget
        budget -= 1
        fresh = probe.rig.probe(probe.claim)
        try:
            error = replay(fresh, candidate)
        except (Inconclusive, KeyError, IndexError):
            return None  # without the steps that were taken out it cannot be done
        finally:
            probe.rig.settle(fresh)
        return error if error is not None and error.key == key else None

    best, error = list(steps), fails(steps)
    if error is None:
        return best, None
    size = max(1, len(best) // 2)
    while size and budget > 0:
        at = 0
        while at < len(best) - 1 and budget > 0:
            candidate = best[:at] + best[min(at + size, len(best) - 1) :]
            shorter = fails(candidate) if len(candidate) < len(best) else None
            if shorter is None:
                at += size
            else:
                best, error = candidate, shorter
        size //= 2
    return best, error


def check(probe: Probe, variant: str) -> None:
    """Run a variant's machine on a drive.

    Raises Refuted, where it can be with the shortest steps that show it, Inconclusive, NotRun where nothing may be sent.
    """
    recorder = run(probe, variant)
    probe.measured["sequences"], probe.measured["steps"] = recorder.sequences, recorder.steps
    failure = recorder.failure
    if failure is None:
        if not recorder.steps:
            raise NotRun("no step of any sequence may be sent")
        return
    if isinstance(failure, Refuted) and probe.drive is not None:
        steps, shorter = shortened(probe, recorder.failed, failure.key)
        if shorter is not None:
            shorter.steps = tuple(steps)
            raise shorter from None
    if isinstance(failure, Refuted):
        # A real drive is not told the same again and again.
        failure.steps = tuple(recorder.failed)
    raise failure
