"""Records of verdicts: the verdict of each claim, as plain data that passes between processes and into files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from analyzer.catalogue import Command, Role
from analyzer.records import CanFrame, Chunk
from conformance.claim import Curve, Outcome, Verdict


class Traffic(msgspec.Struct, frozen=True, array_like=True):
    """Bytes that went over the line: `t_ns` on the line's clock, who sent them, and on CAN the identifier."""

    t_ns: int
    sent: bool
    data: bytes
    can_id: int | None = None
    extended: bool = False


class VerdictRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A verdict as data. `target`: the drive as the user named it; `lines`: the exchange that shows it, for people;
    `asked`: its command.

    `duration_ns` on the line's clock (virtual for an emulated drive). `traffic` only where it is asked for. `noise`: of the
    resting shaft and the line, as the run measured it, by what it is of.
    """

    id: str
    target: str
    theme: str
    dialect: str
    statement: str
    section: str
    certainty: str
    refuted_by: str
    outcome: str
    firmware: str = ""
    reason: str = ""
    expected: str = ""
    got: str = ""
    key: str = ""
    asked: str = ""
    lines: tuple[str, ...] = ()
    quirks: tuple[str, ...] = ()
    covers: tuple[tuple[str, str], ...] = ()
    fields: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    parameters: dict[str, Any] = {}
    measured: dict[str, float] = {}
    series: dict[str, Curve] = {}
    latencies: tuple[tuple[str, int], ...] = ()
    noise: dict[str, float] = {}
    first_ns: int = 0
    last_ns: int = 0
    traffic: tuple[Traffic, ...] = ()

    @property
    def word(self) -> str:
        """The outcome as summaries name it."""
        return Outcome(self.outcome).word

    @property
    def refuted(self) -> bool:
        """Whether the drive is at fault."""
        return self.outcome == Outcome.REFUTED


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What a run was: drives, where, seed, what was allowed, when, how long.

    `seconds`: of the wall clock.
    """

    targets: tuple[str, ...]
    on: tuple[str, ...]
    version: str
    started_at: str
    seconds: float = 0.0
    seed: int = 0
    allowed: tuple[str, ...] = ()
    bounds: dict[str, str] = {}
    command: str = ""
    notes: tuple[str, ...] = ()


def _by_name(value: Any) -> Any:
    """Return a parameter in which each command is its name: the rest of a command is the catalogue's."""
    if isinstance(value, Command):
        return value.name
    if isinstance(value, Mapping):
        return {key: _by_name(each) for key, each in value.items()}
    return [_by_name(each) for each in value] if isinstance(value, (list, tuple)) else value


def record(
    verdict: Verdict, target: str, *, firmware: str = "", traffic: bool = False, noise: Mapping[str, float] | None = None
) -> VerdictRecord:
    """Return a verdict as data; with `traffic` also what went over the line (always, where it is refuted)."""
    claim = verdict.claim
    keep = traffic or verdict.outcome is Outcome.REFUTED
    return VerdictRecord(
        id=claim.id,
        target=target,
        theme=claim.theme.value,
        dialect=claim.dialect,
        statement=claim.statement,
        section=claim.section,
        certainty=claim.certainty.value,
        refuted_by=claim.refuted_by,
        outcome=verdict.outcome.value,
        firmware=firmware,
        reason=verdict.reason,
        expected=verdict.expected,
        got=verdict.got,
        key=verdict.key,
        asked=_asked(verdict),
        lines=tuple(verdict.exchange.lines()) if verdict.exchange is not None else (),
        quirks=verdict.quirks,
        covers=tuple((command, aspect.value) for command, aspect in claim.covers),
        fields=claim.fields,
        commands=claim.commands,
        # As JSON has them: a baseline that was written and read again must match.
        parameters=msgspec.json.decode(msgspec.json.encode(_by_name(claim.parameters))),
        measured=dict(verdict.measured),
        series=dict(verdict.series),
        latencies=verdict.latencies,
        noise=dict(noise or {}),
        first_ns=verdict.first_ns,
        last_ns=verdict.last_ns,
        traffic=(tuple(_traffic(verdict.traffic)) or _shown(verdict)) if keep else (),
    )


def _asked(verdict: Verdict) -> str:
    """Return the name of the command whose exchange shows the verdict, empty where there is none."""
    command = None if verdict.exchange is None else verdict.exchange.command
    return "" if command is None else command.name


def _traffic(items: Iterable[Chunk | CanFrame]) -> Iterable[Traffic]:
    for item in items:
        sent = item.direction is Role.REQUEST
        if isinstance(item, CanFrame):
            yield Traffic(item.t_ns or 0, sent, item.data, item.id, item.extended)
        else:
            yield Traffic(item.t_ns or 0, sent, item.data)


def _shown(verdict: Verdict) -> tuple[Traffic, ...]:
    """Return what the exchange of a verdict shows, for a claim that judged what another one had asked."""
    return () if verdict.exchange is None else tuple(_traffic(verdict.exchange.records()))


def noise_of(records: Iterable[VerdictRecord]) -> dict[str, str]:
    """Return what each drive and its line were measured to tremble by, as text: the last that a claim was given."""
    found = {record.target: record.noise for record in records if record.noise}
    return {
        target: ", ".join(f"{value:g} {what.replace('_', ' ')}" for what, value in noise.items())
        for target, noise in found.items()
    }


def firmware_of(records: Iterable[VerdictRecord]) -> dict[str, str]:
    """Return the firmware that each drive reported."""
    return {r.target: r.firmware for r in records if r.firmware}


#: Inconclusive claims that a run may have, of those that ran: with more of them it is no success.
MOST_INCONCLUSIVE = "10%"


def most_inconclusive(text: str) -> float:
    """Return the share of `10%`, or of a number of claims as a number from 1 on. Raises ValueError."""
    share = float(text.removesuffix("%")) / 100 if text.endswith("%") else float(int(text))
    if not 0 <= share <= (1 if text.endswith("%") else 1e9):
        raise ValueError(text)
    return share if text.endswith("%") else -share


def doubt_about(records: Iterable[VerdictRecord], most: float) -> str:
    """Say why a run proves little: no claim has a verdict, or too many are inconclusive; nothing where neither is so.

    `most`: a share of the claims that ran; below 0 a number of claims.
    """
    ran = [r.outcome for r in records if r.outcome != Outcome.NOT_RUN]
    count = sum(outcome == Outcome.INCONCLUSIVE for outcome in ran)
    if count == len(ran):
        return f"no claim has a verdict: {count} inconclusive, all others did not run"
    limit = -most if most < 0 else most * len(ran)
    return f"{count} of {len(ran)} claims that ran are inconclusive (--max-inconclusive)" if count > limit else ""
