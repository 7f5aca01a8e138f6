"""Framing: a drive ignores every broken request, and always answers the next good one.

Each kind of damage makes two claims: `ignored` (no answer to any variant of it) and `next` (the good read behind it is
answered). What is damaged is a read (`conformance.talk.garbling`), so that nothing a drive makes of it can move a motor.

Rules kept here:
- A good read is asked first: a drive that does not answer it is judged elsewhere.
- Behind each damaged frame the line is quiet for a while before the next good one: nothing printed says how long a drive
  waits for the rest of a frame. What happens without that pause is open, and observed (`without_pause`).
- The manuals say how a frame is checked; that a drive stays silent on one that does not check is certain by that. What
  no manual speaks of (frames of other lengths, unknown codes) is likely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Certainty, Dialect, Doubt, Risk, Role, Subject
from analyzer.link import CanLink, HeadLink, Link, LkLink, ModbusLink
from analyzer.records import CanFrame
from conformance.claim import NotRun, Theme
from conformance.claims.control_reads import PAUSE_NS, ask_first, expect_silence, garblers, judge_next, plain_read
from conformance.claims.declare import Case, claim, described_in
from conformance.claims.known_quirks import known
from conformance.model.lk_parameters import OTHER_FIRMWARE
from conformance.talk import garbling
from conformance.talk.garbling import Garbler, Variant
from conformance.talk.probe import Probe

Makes = Callable[[Probe], Iterable[Variant]]

#: The most variants of one kind: enough to see each bit of a short frame, few enough for a real line.
_MOST = 24
#: How long is listened to one of several whole frames; what is later comes behind the next one.
_WHOLE_NS = 30_000_000
FRAGMENTS = "other-dialect-fragments"
#: First bytes that begin no request, by link.
_OTHER_HEADS: Mapping[type[Link], tuple[int, ...]] = {
    HeadLink: (0xFB, 0xF9, 0x3E, 0xFD, 0xFE, 0x7A, 0x00, 0xFF),
    LkLink: (0x3D, 0x3F, 0xFA, 0xFB, 0xBE, 0x00, 0xFF),
}


# --- kinds of damage --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Damage:
    """One kind of damage. `ignored`, `following`: how sure the two claims are. `links`: None for every link. `of_checks`: for
    links that check their frames. `whole`: as long as its head says.
    """

    name: str
    what: str
    variants: Makes
    ignored: Certainty = Certainty.CERTAIN
    following: Certainty = Certainty.LIKELY
    links: tuple[type[Link], ...] | None = None
    of_checks: bool = False
    risks: frozenset[Risk] = frozenset()
    rests_on: tuple[Doubt, ...] = ()
    quirks: tuple[str, ...] = ()
    whole: bool = False


def _each(make: Callable[[Garbler], Iterable[Variant]]) -> Makes:
    return lambda probe: [v for g in garblers(probe) for v in _some(list(make(g)))]


def _variants(probe: Probe, kind: _Damage) -> Iterator[Variant]:
    """Yield the variants of a kind. Raises NotRun where there is none that is harmless."""
    variants = list(kind.variants(probe))
    if not variants:
        raise NotRun(f"no frame of this kind reads as nothing but a read: {kind.what}")
    yield from variants


def _some(variants: list[Variant]) -> list[Variant]:
    """Return so many of the variants as are enough, evenly spread."""
    step = -(-len(variants) // _MOST) or 1
    return variants[::step]


def _noise(probe: Probe) -> Iterator[Variant]:
    for data in garbling.NOISE:
        yield f"noise {data[:4].hex(' ').upper()}{' ...' if len(data) > 4 else ''}", data


def _other_heads(probe: Probe) -> Iterable[Variant]:
    return garblers(probe)[0].other_heads(_OTHER_HEADS[type(probe.dialect.link)])


def _other_dialects(probe: Probe) -> Iterable[Variant]:
    return garbling.reads_of_others(probe.dialect, probe.address)


def _unknown_codes(dialect: Dialect) -> list[int]:
    """Return codes that no command has, beside those that one has."""
    known = {c.code for c in dialect.commands}
    beside = {code for k in known for code in (k - 1, k + 1, k ^ 0x80, k ^ 0x40)}
    # A head in the place of a code would be the next frame's.
    fit = sorted(c for c in beside - known - _UNWANTED - registry.first_bytes() if 0 < c <= 0xFF)
    step = -(-len(fit) // _MOST) or 1
    return fit[::step]


def _with_unknown_codes(probe: Probe) -> Iterator[Variant]:
    dialect, link = probe.dialect, probe.dialect.link
    command = plain_read(dialect)
    read = probe.build(command)
    for code in (*_unknown_codes(dialect), *dialect.unlisted_codes):
        other = replace(command, code=code)
        can_id = link.identifier(other, probe.address)
        frame = link.build(other, read.form, probe.address, b"", Role.REQUEST)
        item = replace(read, can_id=can_id).item(frame)
        # An identifier has few bits for a code: more of them would name another node.
        named = link.parse(frame, can_id)
        fits = (named.code, named.address) == (code, probe.address)
        if fits and garbling.harmless(item, probe.address, read.frame, beside=_UNKNOWN, dialect=dialect):
            yield _coded(code), item


def _coded(code: int) -> str:
    return f"the unknown code {code:02X}"


def _strange_frames(probe: Probe) -> Iterator[Variant]:
    read = probe.build(plain_read(probe.dialect))
    assert read.can_id is not None  # only links of CAN have these
    for what, extended, remote in (("an identifier of 29 bits", True, False), ("a remote frame", False, True)):
        data = b"" if remote else read.frame
        yield what, CanFrame(None, "bus", read.can_id, data, extended=extended, remote=remote)


#: Codes that other firmware was seen to have: one that it answers, and some with unwanted effects.
_UNWANTED = frozenset({0x07, 0x40, 0x42})
_UNKNOWN = frozenset({Risk.UNKNOWN})

_KINDS = (
    _Damage("checksum_bit", "a request with one bit of its checksum flipped", _each(Garbler.check_bits), of_checks=True,
          rests_on=(Doubt.CHECK,)),
    _Damage("checksum_value", "a request whose checksum is reckoned otherwise", _each(Garbler.wrong_checks), of_checks=True,
          rests_on=(Doubt.CHECK, Doubt.CHECK_OF_ADDRESS)),
    _Damage("flipped_bit", "a request with one bit flipped before its checksum", _each(Garbler.body_bits), of_checks=True),
    _Damage("truncated", "a request that breaks off", _each(Garbler.truncated)),
    _Damage("overlong", "a request with data that its command does not have", _each(Garbler.overlong),
          ignored=Certainty.LIKELY, rests_on=(Doubt.LAYOUT,)),
    _Damage("underlong", "a request with less data than its command has", _each(Garbler.underlong),
          ignored=Certainty.LIKELY, links=(LkLink, CanLink), rests_on=(Doubt.LAYOUT,)),
    _Damage("noise", "noise", _noise, links=(HeadLink, LkLink, ModbusLink)),
    _Damage("head", "a frame with another head than a request's", _other_heads, links=(HeadLink, LkLink)),
    _Damage("other_dialect", "a good request in another dialect", _other_dialects, ignored=Certainty.LIKELY,
          links=(HeadLink, LkLink, ModbusLink), quirks=(FRAGMENTS,)),
    _Damage("unknown_code", "a good frame of a code that the manual does not list", _with_unknown_codes,
          ignored=Certainty.LIKELY, links=(HeadLink, LkLink, CanLink), risks=_UNKNOWN,
          quirks=(OTHER_FIRMWARE,), whole=True),
    _Damage("frame_type", "a frame that is no data frame of 11 bits", _strange_frames, ignored=Certainty.LIKELY,
          links=(CanLink,), risks=_UNKNOWN),
)  # fmt: skip


def _tolerated(dialect: Dialect, kind: _Damage, what: str) -> bool:
    """Say whether a quirk explains the answer to a variant: other firmware has codes of its own, and no more."""
    return OTHER_FIRMWARE not in kind.quirks or what in map(_coded, dialect.unlisted_codes)


# --- the claims about each --------------------------------------------------------------------------------------------


def _kinds(dialect: Dialect) -> Iterator[Case]:
    for kind in _KINDS:
        fits = kind.links is None or isinstance(dialect.link, kind.links)
        if fits and (dialect.link.checked or not kind.of_checks):
            what = f"{kind.what[0].upper()}{kind.what[1:]}"
            facts = {"risks": kind.risks, "parameters": {}}
            yield Case(dialect, given={"kind": kind, "damaged": what, "lower": kind.what}, facts=facts)


def _of_kinds(refuted_by: str, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return claim(Theme.FRAMING, each=_kinds, refuted_by=refuted_by, section=described_in(Subject.FRAMING), **facts)


@_of_kinds(
    "any answer",
    name="{kind}/ignored",
    at_best=lambda case: case["kind"].ignored,
    rests_on=lambda case: case["kind"].rests_on,
    quirks=lambda case: known(case.dialect, *case["kind"].quirks),
)
def _ignored(probe: Probe, kind: _Damage) -> None:
    """{damaged} is not answered."""
    ask_first(probe)
    for what, item in _variants(probe, kind):
        # Whole frames need no pause between them in which a drive gives up a part of one.
        exchange = probe.send(item, timeout_ns=min(_WHOLE_NS, probe.rig.silence_ns) if kind.whole else None)
        if not exchange.silent and probe.claim.quirks and _tolerated(probe.dialect, kind, what):
            probe.meets(probe.claim.quirks[0])
            continue
        expect_silence(probe, exchange, f"{what}: answered", key=f"{kind.name}: answered")


@_of_kinds("silence, or another answer than the request's", name="{kind}/next", at_best=lambda case: case["kind"].following)
def _next(probe: Probe, kind: _Damage) -> None:
    """The next good request behind {lower} is answered."""
    ask_first(probe)
    for what, item in _variants(probe, kind):
        judge_next(probe, f"a damaged one ({what})", partial(probe.send, item, timeout_ns=PAUSE_NS))
