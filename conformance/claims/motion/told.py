"""What reads tell of a motor while it turns, either way, and when it stands again (MKS): what turning changes alone.

A read that is right at rest can be wrong in motion: from a copy that is not kept up, by a sign, by a state that is read for
another. Each motion here is looked at by several reads.

Rules kept here:
- A loop may lag behind what it counts by 45 degrees while it turns.
- The motor is on and was never held, so nothing but numbers of the shaft may change.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Command, Dialect, Role, Verb
from analyzer.codec import codec
from analyzer.link import HeadLink
from conformance.claims.control_reads import is_answered, received_text
from conformance.claims.declare import Case, commands
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.motion import motion
from conformance.motion.declared import QUICK
from conformance.talk.probe import MS, Probe, Until

#: What reads the state of a motor, and in which field.
_STATES = ((Verb.READ_ENABLED, "enabled"), (Verb.READ_PROTECTION, "status"), (Verb.READ_ZERO_STATUS, "status"))
#: Degrees that a loop may lag behind while it turns, and when it stands.
_LAG, _REST = 45.0, 1.0
_RPM = 120


def _runs(dialect: Dialect) -> Iterator[Case]:
    if dialect.family == "mks" and dialect.counts_per_turn:
        yield from commands(Verb.RUN_SPEED)(dialect)


def states(probe: Probe) -> dict[str, int]:
    """Return what reads tell of the motor's state that motion leaves as it is."""
    known = probe.dialect.by_verb
    return {verb.value: probe.read(verb, field) for verb, field in _STATES if verb in known}


def expect_states(probe: Probe, before: dict[str, int], when: str) -> None:
    """Refute where these states read otherwise than before."""
    text = f"reads of the motor's state tell something else {when}"
    seen = states(probe)
    probe.expect(str(seen), holds=seen == before, expected=str(before), refutes=text)


def _expect_error(probe: Probe, most: float, when: str) -> None:
    read = probe.dialect.by_verb.get(Verb.READ_ANGLE_ERROR)
    if read is not None:
        error = float(read.reply_forms[0].layout.named["angle_error"].physical(probe.read(read, "angle_error")))
        text = f"the angle error of a free shaft {when} is that of one that is held"
        probe.expect(abs(error), at_most=most, unit="degrees", refutes=text)


@of_motion(
    each=_runs, name="{command}/leaves-states", refuted_by="another state", risks=risks_by(Verb.RUN_SPEED, Verb.EMERGENCY_STOP)
)
def _leaves_states(probe: Probe) -> None:
    """A run, either way, and its stop change nothing that is read of enabling, protection and the way to zero."""
    motion.ready_to_move(probe)
    before = states(probe)
    # Farther back than there, so that both sides of where it began are looked at.
    for rpm, stop, for_ns in ((_RPM, Verb.STOP_SPEED, 600 * MS), (-_RPM, Verb.EMERGENCY_STOP, 1_400 * MS)):
        motion.run_at(probe, rpm, QUICK)
        probe.wait(for_ns)
        expect_states(probe, before, "while it turns")
        _expect_error(probe, _LAG, "that turns")
        probe.do(stop, {"acceleration": QUICK} if stop is Verb.STOP_SPEED else None)
        motion.wait_standing(probe)
        expect_states(probe, before, f"after {probe.command(stop).name}")
        _expect_error(probe, _REST, "at rest, turns away,")


# --- replies of every check -------------------------------------------------------------------------------------------


def _with_one_check(dialect: Dialect) -> Iterator[Case]:
    """Yield the read of the position where a check of one byte covers it."""
    if isinstance(dialect.link, HeadLink) and Verb.MOVE_ABSOLUTE_AXIS in dialect.by_verb:
        yield from commands(Verb.READ_POSITION)(dialect)


@of_motion(each=_with_one_check, refuted_by="a reply whose checksum does not fit", risks=risks_by(Verb.MOVE_ABSOLUTE_AXIS))
def _each_check(probe: Probe, command: Command) -> None:
    """A reply whose checksum is zero, FF or the head of a frame is as good as any other."""
    move, form = probe.command(Verb.MOVE_ABSOLUTE_AXIS), command.reply_forms[0]
    motion.prepare(probe, move)

    def check(place: int) -> int:
        data = codec(form.layout).encode({"position": place})
        return probe.dialect.link.build(command, form, probe.address, data, Role.REPLY)[-1]

    for wanted in (0x00, 0xFF, 0xFA, 0xFB, 0xFC):
        here = motion.place(probe, move)
        place = next((p for p in range(here + 1, here + 600) if check(p) == wanted), None)
        if place is None:
            continue
        degrees = (place - here) * 360 / probe.dialect.counts_per_turn
        motion.begin(probe, move, degrees, acceleration=QUICK, start=here)
        # Nothing is read until its end is told: a reply that does not check is what is looked for.
        probe.listen(_ARRIVES_NS, Until.REPLY)
        probe.wait(_SETTLES_NS)
        bad: set[str] = set()
        for _ in range(_LOOKS):
            exchange = probe.ask(command, quiet_ns=0)
            if is_answered(exchange):
                continue
            got = received_text(exchange)
            text = f"a reply at a place whose checksum is {wanted:02X} does not check, or none comes"
            # What a drive sends of one place is the same each time. A line damages two replies in two ways.
            probe.expect(got, holds=got not in bad, expected="a reply that checks", refutes=text, exchange=exchange)
            bad.add(got)


#: How often a place is read: an encoder that trembles shows it now and then, and it must show twice.
_LOOKS = 8
#: How long such a move takes at most, and a shaft to settle behind it.
_ARRIVES_NS, _SETTLES_NS = 250 * MS, 30 * MS
