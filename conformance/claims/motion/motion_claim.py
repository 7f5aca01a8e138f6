"""Declaring claims about motion: what those that move a motor have in common.

    @of_motion(each=motions(MotionKind.RUN), refuted_by="a shaft that stops by itself")
    def lasts(probe: Probe, command: Command) -> None:
        '''A run goes on until it is told otherwise.'''

The risks and settings of making a drive ready are named for it. A check of two families in two statements is declared twice:
each declaration names its cases, its statement and what would refute it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Aspect, Inconclusive, Refuted, Theme
from conformance.claims.declare import Case, Cases, claim, motions
from conformance.claims.known_quirks import SETTLING
from conformance.model.lk_parameters import need_room
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import CALM, QUICK, RUNS_AND_MOVES, SAME
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe, Until

#: How far a shaft that is settling was seen to be from where it comes to rest, in degrees, and a little more.
_SETTLING = 32 * 360 / 16384
#: How far one that does not tremble may be off when it arrives: the shaft that was seen to settle was 14 counts off.
_SWINGS = 11 * 360 / 16384
#: How long that was seen to take.
_SETTLES_NS = 100 * MS


def of_motion(
    *,
    each: Cases,
    refuted_by: Any,
    theme: Theme = Theme.MOTION,
    risks: Callable[[Case], Iterable[Risk]] | Iterable[Risk] = (),
    own: Callable[[Case], Iterable[Risk]] | None = None,
    settings: Callable[[Case], Iterable[str]] | Iterable[str] = (),
    still: bool = False,
    **facts: Any,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check of a command that moves, or of one that a moving drive is asked; see `claim`.

    `risks`, `settings`: in addition to those of making a drive ready and of the command. `own`: the command's risks with the
    sent values alone, for no claim of this theme sends values that no manual explains.
    `still`: the drive is not made ready to move.
    """

    def named(case: Case) -> tuple[str, ...]:
        return tuple(dict.fromkeys(n for f in command_of(case).request_forms for n in f.layout.named))

    def all_risks(case: Case) -> frozenset[Risk]:
        of_command = command_of(case).all_risks - {Risk.UNKNOWN} if own is None else own(case)
        more = {*(risks(case) if callable(risks) else risks), *of_command}
        return frozenset(more) if still else declared.risks(case.dialect, *more)

    def all_settings(case: Case) -> tuple[str, ...]:
        more = settings(case) if callable(settings) else settings
        return tuple(more) if still else declared.settings(case.dialect, *more)

    facts = {"aspect": Aspect.MOTION, "fields": named, "first": _need_room, **facts}
    return claim(theme, each=each, refuted_by=refuted_by, risks=all_risks, settings=all_settings, **facts)


def of_rows(
    rows: Callable[[Probe, Command], Any], **facts: Any
) -> Callable[[Callable[[Probe, Command, Any], None]], Callable[[Probe, Command, Any], None]]:
    """Declare a judge of what several motions showed, as `of_motion` does: its claim judges what `rows` returns.

    The judge itself takes any rows, so that another claim can have it judge some of them.
    """

    def declare(judge: Callable[[Probe, Command, Any], None]) -> Callable[[Probe, Command, Any], None]:
        def check(probe: Probe, command: Command) -> None:
            judge(probe, command, rows(probe, command))

        check.__name__, check.__doc__, check.__module__ = judge.__name__, judge.__doc__, judge.__module__
        of_motion(**facts)(check)
        return judge

    return declare


def _need_room(probe: Probe) -> None:
    """Raise Inconclusive where a claim is about a move to a place, and a drive's own limit of the angle is in its way."""
    commands = (probe.dialect.by_name.get(name) for name in probe.claim.commands)
    if any(c is not None and c.motion is not None and c.motion.kind is MotionKind.MOVE_TO for c in commands):
        need_room(probe)


def command_of(case: Case) -> Command:
    """Return the command that a claim about motion is about."""
    assert case.command is not None  # a claim about motion is about a command
    return case.command


def risks_of(*names: str) -> Callable[[Case], frozenset[Risk]]:
    """Return what tells all risks of some arguments of a case, which are commands."""
    return lambda case: frozenset().union(*(case[name].all_risks for name in names))


def risks_by(*verbs: Verb) -> Callable[[Case], frozenset[Risk]]:
    """Return what tells all risks of the commands of some verbs, those that the dialect has."""
    return lambda case: frozenset().union(*(c.all_risks for v in verbs if (c := case.dialect.by_verb.get(v)) is not None))


def by_bus(dialect: Dialect) -> Iterator[Case]:
    """Yield the runs and moves of the MKS drives; a damaged one is small and slow as the whole one is."""
    if dialect.family == "mks":
        yield from motions(*RUNS_AND_MOVES)(dialect)


def has_direction(command: Command) -> bool:
    """Say whether a motion has a direction beside its distance or speed, which has no sign then."""
    return bool(declared.of(command).direction)


def has_sign(command: Command) -> bool:
    """Say whether the sign of a motion's distance or speed is its direction."""
    return not has_direction(command)


def that_tell_their_end(each: Cases) -> Cases:
    """Return those of some cases whose dialect tells the end of a motion by a reply of its own."""
    return lambda dialect: each(dialect) if arriving.tells_end(dialect) else ()


def expect_stays(before: Sample, after: Sample, exchange: Exchange | None, text: str, within: float = SAME) -> None:
    """Refute unless the shaft is where it was, `within` so many degrees."""
    moved = after.value - before.value
    if abs(moved) > within + after.noise:
        raise Refuted(text, expected="no motion", got=f"the shaft moved by {moved:+.2f} degrees", exchange=exchange)


def expect_not_turned(probe: Probe, before: Sample, exchange: Exchange, text: str) -> None:
    """Refute unless the shaft is where it was; a shaft that turns is stopped first."""
    after = motion.position(probe)
    if abs(after.value - before.value) > motion.same(probe):
        motion.stop(probe)
    expect_stays(before, after, exchange, text)


def expect_speed(seen: Sample | float, rpm: float, exchange: Exchange | None, text: str, share: float = CLOCK_SHARE) -> None:
    """Refute unless a speed is near `rpm`, in either direction."""
    value, noise = (abs(seen), 0.0) if isinstance(seen, float) else (abs(seen.value), seen.noise)
    if abs(value - abs(rpm)) > 1 + abs(rpm) * share + noise:
        raise Refuted(text, expected=f"{abs(rpm):g} rpm", got=f"{value:g} rpm", exchange=exchange)


def expect_taken(probe: Probe, exchange: Exchange, refutes: str) -> None:
    """Refute where a motion was refused."""
    taken = not motion.refused(probe, exchange)
    probe.expect("a refusal", holds=taken, expected="no refusal", refutes=refutes, exchange=exchange)


def expect_goes(probe: Probe, move: Command, degrees: float, when: str, rpm: float = CALM, acceleration: int = QUICK) -> None:
    """Ask for a move; refute where it is refused, or does not go as far as asked, to one side or the other."""
    before, until = motion.position(probe), Until.DONE if declared.of(move).tells_end else Until.REPLY
    exchange = motion.ask(probe, move, degrees, rpm=rpm, acceleration=acceleration, until=until)
    expect_taken(probe, exchange, f"{move.name} is refused {when}")
    probe.wait(exchange.sent_ns + int(ramp.move_ns(degrees / 360, rpm, acceleration)) - probe.gate.now_ns())
    went = abs(motion.wait_standing(probe).value - before.value)
    text, within = f"{move.name} does not go as far as asked {when}", motion.miss(probe) + motion.same(probe)
    probe.expect(went, near=abs(degrees), within=within, unit="degrees", refutes=text, exchange=exchange)


def expect_row_taken(probe: Probe, exchange: Exchange, row: object, refutes: str) -> None:
    """Refute where the command of a row was refused. A reply that is lost or damaged says nothing; `row`: for people."""
    taken = not (exchange.is_read and probe.refused(exchange))
    probe.expect("a refusal", holds=taken, expected=f"no refusal: {row}", refutes=refutes, exchange=exchange)


def expect_between(
    probe: Probe,
    got: float,
    span: tuple[float, float],
    within: float,
    row: object,
    refutes: str,
    exchange: Exchange,
    unit: str = "degrees",
) -> None:
    """Refute unless a number is in a span, give or take `within`. `row`: what was tried, for people."""
    low, high = span[0] - within, span[1] + within
    expected = f"{low:.5g} to {high:.5g} {unit}: {row}"
    probe.expect(got, at_least=low, at_most=high, unit=unit, expected=expected, refutes=refutes, exchange=exchange)


def expect_at_rest(probe: Probe, command: Command, exchange: Exchange, refutes: str) -> None:
    """Refute unless the shaft is at rest where it is when a command has just been told as complete."""
    probe.reply(exchange)
    at_once = motion.position(probe)
    told = tuple(exchange.status(command.replies.status)[-1:])
    motion.wait_standing(probe)
    # A shaft that settles may stand for a moment, beside where it comes to rest.
    probe.wait(_SETTLES_NS if probe.noise.settles else 0)
    expect_rested(probe, command, told, at_once, motion.position(probe), exchange, refutes)


def expect_rested(
    probe: Probe, command: Command, told: tuple[int, ...], at_once: Sample, rests: Sample, exchange: Exchange, refutes: str
) -> None:
    """Refute unless the shaft was where it rests when a command was told as complete (`told`: its last status)."""
    if told not in ((2,), (3,)):
        raise Inconclusive(f"{command.name} did not say that it was complete")
    off = abs(rests.value - at_once.value)
    known = SETTLING in probe.claim.quirks
    # Where a quiet shaft arrives by more than that, what the run measured of it is the quirk itself.
    swing = min(probe.noise.swing, _SWINGS) if known and not probe.noise.live else probe.noise.swing
    most = SAME + swing
    if known and most < off <= _SETTLING + probe.noise.place:
        probe.meets(SETTLING)
    else:
        probe.expect(off, at_most=most, unit="degrees from where it comes to rest", refutes=refutes, exchange=exchange)
