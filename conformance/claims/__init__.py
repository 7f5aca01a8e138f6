"""The claims, by theme: one module each, every one made from the catalogue wherever it can be.

The checks of each module are declared as claims (`declare`); a module that makes its claims another way offers
`claims(dialect) -> Iterator[Claim]`. Other packages add theirs by entry points of the group
`servotap.claims`, each naming a module with declared checks or such a function.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from types import ModuleType

from analyzer import plugins
from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from conformance.claim import Claim, Theme
from conformance.claims.declare import declared_in, made

GROUP = "servotap.claims"
#: Theme modules, in the order in which they run: what is quick and harmless first.
MODULES = (
    # shape
    "frames.shape",
    "frames.shape_parameters",
    # framing
    "frames.framing",
    "frames.without_pause",
    "frames.executed",
    # examples
    "frames.examples",
    "frames.examples_many",
    # addressing
    "addressing.own",
    "addressing.many",
    "addressing.under_way",
    "addressing.protection",
    "addressing.links",
    "addressing.package",
    "addressing.every_slot",
    "addressing.guarded",
    # traffic
    "frames.traffic",
    # modbus
    "modbus.functions",
    "modbus.writes",
    # ranges
    "ranges.settings",
    "ranges.motions",
    "ranges.obeyed",
    "ranges.parameters",
    "ranges.link",
    # read-back
    "settings.read_back",
    "settings.effects",
    "settings.restart",
    "settings.kept_run",
    "settings.kept_zero",
    "settings.restart_together",
    "settings.restore",
    # timing
    "timing",
    "motion.ramps",
    "motion.durations",
    # motion
    "motion.moves",
    "motion.far_moves",
    "motion.sums",
    "motion.runs",
    "motion.newer_motion",
    "motion.speed_limits",
    "motion.subdivisions",
    "motion.own_values",
    "motion.stops",
    "motion.enabling",
    "motion.motor_states",
    "motion.refusals",
    "motion.reads",
    "motion.told",
    "motion.standing_reads",
    "crossed.motions",
    "crossed.newer",
    "crossed.homing",
    "motion.slowing",
    "crossed.stops",
    "crossed.behind_ends",
    "crossed.reads",
    "crossed.goal_claims",
    "lk.torque",
    "lk.health",
    "lk.told_state",
    "lk.encoder_zero",
    "lk.limits",
    "lk.speed_ramp",
    "lk.slopes",
    "motion.responding",
    "motion.set_zero",
    "motion.homing",
    "motion.end_limits",
    "motion.protection",
    "motion.calibrating",
    # state
    "state",
    # resilience
    "resilience.requests",
    "resilience.reads",
    "resilience.inert_reads",
    "resilience.settings",
    "resilience.switches",
    "resilience.busy",
)
Source = Callable[[Dialect], Iterable[Claim]]


def every(dialect: Dialect) -> tuple[Claim, ...]:
    """Return all claims about a dialect (as one model speaks it, where it was made for a model), in order.

    They are made once, and kept with the dialect. Raises UsageError for an added source that gives two claims of one id
    or something that is no claim.
    """
    kept: tuple[Claim, ...] | None = dialect.__dict__.get("_claims")
    if kept is None:
        kept = dialect.__dict__["_claims"] = _made(dialect)
    return kept


def _made(dialect: Dialect) -> tuple[Claim, ...]:
    found: dict[str, Claim] = {}
    for claims in _sources():
        for claim in claims(dialect):
            if not isinstance(claim, Claim):
                raise UsageError(f"{claims.__module__}: expected claims, got {type(claim).__name__}")
            if claim.id in found:
                raise UsageError(f"two claims of the id {claim.id}")
            if not claim.models or not dialect.model or dialect.model in claim.models:
                found[claim.id] = claim
    return tuple(found.values())


def _sources() -> list[Source]:
    added = [_added(name, found) for name, found in plugins.loaded(GROUP)]
    return [_source(f"{__name__}.{name}") for name in MODULES] + added


def _added(name: str, loaded: ModuleType | Source) -> Source:
    source = partial(declared_in, loaded.__name__) if isinstance(loaded, ModuleType) else loaded

    return lambda dialect: plugins.attempt(f"{name} of {GROUP}", lambda: list(source(dialect))) or ()


def _source(name: str) -> Source:
    own: Source | None = getattr(import_module(name), "claims", None)
    if own is None:
        return partial(declared_in, name)
    what = name.rpartition(".")[2]
    return lambda dialect: made(dialect, Theme(what.replace("_", "-")), what, own)
