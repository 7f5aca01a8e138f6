"""Reads of what cannot be read: a drive does nothing on them.

    CAN      00 91 -> 91 FF FF                    goes not home
    Modbus   01 04 00 91 00 01 -> 01 84 02        goes not home

Rules kept here:
- What the drive answers is for the themes shape and modbus.
- The shaft is away from zero, so that a zero set there shows; it turns then, so that a stop shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from analyzer.catalogue import Dialect, Verb
from analyzer.link import READS, ModbusLink
from analyzer.records import CanFrame
from conformance.claim import Theme
from conformance.claims.control_reads import plain_read
from conformance.claims.declare import Case, claim
from conformance.claims.known_reads import every_read, is_stored
from conformance.claims.modbus.frames import request
from conformance.claims.motion.motion_claim import expect_speed
from conformance.motion import declared, motion
from conformance.talk.garbling import harmless
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe, Until

#: How far from zero the shaft is (degrees), how long what began shows, and how fast the shaft turns (rpm).
_AWAY, _BEGINS_NS, _RPM = 75, 60 * MS, 90
_Make = Callable[[Probe, int], bytes | CanFrame]


def _as_parameter(probe: Probe, code: int) -> bytes | CanFrame:
    read = probe.command(Verb.READ_PARAMETER)
    return probe.build(read, {next(iter(read.request_forms[0].layout.named)): code}).item()


def _as_register(probe: Probe, code: int) -> bytes | CanFrame:
    function = next(c.function for c in probe.dialect.commands if c.function in READS)
    return request(probe, function or 0, code, 1)


def _unreadable(dialect: Dialect) -> tuple[_Make, list[int]] | None:
    """Return how a dialect reads what has a code, and the codes of what is only done or written; None where it does not."""
    read = dialect.by_verb.get(Verb.READ_PARAMETER)
    if isinstance(dialect.link, ModbusLink):
        make, readable = _as_register, {c.code for c in dialect.commands if c.function in READS}
    elif read is not None and read.replies.failed_forms:
        (field,) = read.request_forms[0].layout.named.values()
        make, readable = _as_parameter, {read.code, *field.choice_names}
    else:
        return None
    return make, sorted({c.code for c in dialect.commands} - readable)


def _is_harmless(probe: Probe, item: bytes | CanFrame) -> bool:
    """Say whether no dialect takes a read for more than that, also between the reads that stand around it."""
    judged = partial(harmless, address=probe.address, beside=probe.claim.risks, dialect=probe.dialect)
    if isinstance(item, CanFrame):
        return judged(item)
    around = [probe.build(read(probe.dialect)).frame for read in (declared.reads_position, declared.reads_speed)]
    return all(judged(each + item, behind=each) for each in around)


def _cases(dialect: Dialect) -> Iterator[Case]:
    found = _unreadable(dialect) if declared.can_move(dialect) else None
    if found is not None:
        make, codes = found
        yield Case(dialect, given={"make": make, "codes": codes})


@claim(
    Theme.RESILIENCE,
    each=_cases,
    name="reads/of-what-is-done",
    refuted_by="a shaft that moves or stops, another position, or another setting",
    section=lambda case: (case.dialect.by_verb.get(Verb.READ_PARAMETER) or plain_read(case.dialect)).section,
    risks=lambda case: declared.risks(case.dialect, *case.dialect.by_verb[Verb.RUN_SPEED].all_risks),
    settings=lambda case: declared.settings(case.dialect),
    parameters={},
)
def _do_nothing(probe: Probe, make: _Make, codes: list[int]) -> None:
    """A read of what can only be done or written does nothing: the shaft stays as it is, and what is stored too."""
    codes = [code for code in codes if _is_harmless(probe, make(probe, code))]
    move = declared.any_move(probe.dialect)
    motion.prepare(probe, move)
    motion.begin(probe, move, _AWAY)
    motion.stand_still(probe)
    stored = [(c, values, probe.reply(probe.ask(c, values)).values) for c, values in every_read(probe.dialect) if is_stored(c)]
    place, most = motion.position(probe).value, motion.same(probe) + probe.noise.swing
    for code in codes:
        sent = probe.send(make(probe, code), until=Until.REPLY, timeout_ns=probe.rig.late_ns)
        probe.wait(_BEGINS_NS)
        text = f"a read of {code:02X} moves the shaft, or the zero"
        key = "a read moves the shaft, or the zero"
        probe.expect(
            motion.position(probe).value, near=place, within=most, unit="degrees", refutes=text, exchange=sent, key=key
        )
    for command, values, before in stored:
        text = f"{command.name} reads something else behind reads of what cannot be read"
        exchange = probe.ask(command, values)
        probe.expect(probe.reply(exchange).values, equal=before, refutes=text, exchange=exchange, key="reads change a setting")
    begun = motion.run_at(probe, _RPM)
    probe.wait(2 * _BEGINS_NS)
    expect_speed(motion.turning(probe), _RPM, begun, "the run behind such reads has another speed", share=2 * CLOCK_SHARE)
    for code in codes:
        sent = probe.send(make(probe, code), until=Until.REPLY, timeout_ns=probe.rig.late_ns)
        text = f"a read of {code:02X} changes the speed of the shaft"
        expect_speed(motion.turning(probe), _RPM, sent, text, share=2 * CLOCK_SHARE)
