"""The locked-rotor protection by what several drives are sent: switched on, acting, refusing motion, and released so.

    88 01, 83 00 (no current), a move to address 0    ->  3E reads 1: the shaft does not follow
    each motion to address 0, with current again      ->  nothing turns
    3D to address 0                                   ->  3E reads 0

Rules kept here:
- None of it is answered, so that 3E and the shaft tell.
- A drive that does not take such a motor for a locked one by its own address proves nothing by another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.addressing.ways import Many, addresses, addressing
from conformance.claims.control_reads import expect_silence
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import expect_not_turned
from conformance.claims.motion.protection import current, end_limp, is_protected, limp_move
from conformance.motion import declared, motion, ramp
from conformance.motion.declared import MOVES, QUICK
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe

#: How far and how fast a motor without current is asked to turn (degrees, rpm); what the drive has behind that to see it lag.
_FAR, _RPM, _LAGS_NS = 720, 240, 500 * MS
#: How long a setting and a motion are listened to, and a tenth of a turn (degrees).
_TOLD_NS, _SHORT = 40 * MS, 36
_NEEDED = (Verb.SET_PROTECTION, Verb.SET_CURRENT, Verb.RELEASE_PROTECTION, Verb.READ_PROTECTION, Verb.ENABLE)


def _cases(dialect: Dialect) -> Iterator[Case]:
    """Yield each address of several drives; each has another move."""
    if not all(verb in dialect.by_verb for verb in _NEEDED):
        return
    moves = dialect.motions(*MOVES)
    risks = {risk for verb in _NEEDED for risk in dialect.by_verb[verb].all_risks} - {Risk.UNKNOWN}
    for number, many in enumerate(addresses(dialect)):
        facts = {
            "risks": declared.risks(dialect, *risks, *many.risks(dialect), Risk.UNBOUNDED, Risk.TORQUE),
            "settings": (*declared.settings(dialect, "protection", "current"), *many.settings),
        }
        yield Case(dialect, given={"many": many, "what": many.what, "move": moves[-1 - number]}, facts=facts)


@addressing("3E that reads otherwise, a motion, or an answer", _cases, name="{many}/protection", at_best=Certainty.LIKELY)
def _protection(probe: Probe, many: Many, move: Command) -> None:
    """By {what} the protection is switched on and released; it acts on {move}, and refuses motion, sent so."""
    motion.prepare(probe, move)
    to = many.join(probe)

    def tell(command: Command, values: Mapping[str, int]) -> Exchange:
        sent = probe.send(many.frame(probe, command, values, to), timeout_ns=_TOLD_NS)
        expect_silence(probe, sent, f"{command.name} by {many.what} is answered")
        return sent

    tell(probe.command(Verb.SET_PROTECTION), {"protection": 1})
    tell(probe.command(Verb.SET_CURRENT), current(probe, False))
    start = motion.place(probe, move)
    sent = tell(move, declared.values_of(probe.dialect, move, _FAR, rpm=_RPM, start=start))
    probe.wait(int(ramp.move_ns(_FAR / 360, _RPM, QUICK)) + _LAGS_NS)
    if not is_protected(probe):
        _expect_unprotected(probe, many, move, sent)
    tell(probe.command(Verb.SET_CURRENT), current(probe, True))
    before = motion.position(probe)
    for each in probe.dialect.motions(MotionKind.RUN, *MOVES):
        sent = tell(each, declared.values_of(probe.dialect, each, _SHORT, start=motion.place(probe, each)))
    expect_not_turned(probe, before, sent, f"a motion by {many.what} turns a shaft that is protected")
    sent = tell(probe.command(Verb.RELEASE_PROTECTION), {})
    text = f"3E reads protected after 3D by {many.what}"
    probe.expect(is_protected(probe), equal=0, refutes=text, exchange=sent)


def _expect_unprotected(probe: Probe, many: Many, move: Command, sent: Exchange) -> None:
    """Refute where the drive is protected when the same is sent to it alone. Raises Inconclusive otherwise."""
    end_limp(probe)
    motion.prepare(probe, move)
    probe.do(Verb.SET_PROTECTION, {"protection": 1})
    limp_move(probe, _FAR, move=move)
    alone = is_protected(probe)
    end_limp(probe)
    probe.do(Verb.RELEASE_PROTECTION)
    text = f"a motor without current, both by {many.what}, is not protected in {move.name} sent so"
    probe.expect(
        "3E reads 0", holds=not alone, expected="3E 1, as when it is sent to the drive itself", refutes=text, exchange=sent
    )
    raise Inconclusive("the drive does not take a motor without current for a locked one")
