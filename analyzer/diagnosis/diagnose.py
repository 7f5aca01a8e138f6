"""Ask the hypotheses about what a watch has kept."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import msgspec
from msgspec.structs import replace

from analyzer.catalogue import Dialect
from analyzer.diagnosis import (
    adapters,
    answerer,
    can_bus,
    checks,
    echo,
    haste,
    host,
    lengths,
    line,
    meant,
    other_makers,
    other_protocols,
    pace,
    printed,
    quirks,
    refused,
    requests,
    senders,
    silence,
    spoiled,
    told,
    values,
    wrapped,
)
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.ranking import Ranked, ranked
from analyzer.diagnosis.scene import SILENT, Confidence, Piece, Scene, Suspicion, Trouble
from analyzer.diagnosis.watch import Watch
from analyzer.errors import PluginError
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame, Chunk
from analyzer.values import counted

#: A row a subject: each is asked about a scene, and yields what it suspects. What costs most comes last.
HYPOTHESES: tuple[Callable[[Scene], Iterator[Suspicion]], ...] = (
    wrapped.look,
    can_bus.look,
    adapters.look,
    other_makers.look,
    checks.look,
    printed.look,
    values.look,
    lengths.look,
    requests.look,
    spoiled.look,
    meant.look,
    echo.look,
    host.look,
    answerer.look,
    pace.look,
    haste.look,
    silence.look,
    refused.look,
    quirks.look,
    other_protocols.look,
    line.look,
    senders.look,
    told.look,
)
#: What is asked of the text of a program: whether it sends digits for bytes, whose motor it is for, whether the checks of whole
#: frames are right, and what its words tell.
_OF_PROGRAMS = (wrapped.look, other_makers.look, checks.of_program, told.look)


class Diagnosis(msgspec.Struct, frozen=True):
    """What is wrong in a capture. `verdict`: ok, trouble, unknown; `troubles`: how many things are wrong.

    `unexplained`: what can be said where no cause is named. `remark`: what is as it may be.
    """

    verdict: str
    causes: tuple[Ranked, ...]
    troubles: int
    unexplained: str = ""
    remark: str = ""

    def as_objects(self) -> list[dict[str, Any]]:
        """Return the causes for JSON."""
        return [
            {
                "cause": each.suspicion.cause,
                "confidence": each.suspicion.confidence.value,
                "share": round(each.share, 3),
                "count": len(each.suspicion.troubles),
                "say": each.suspicion.say,
                "evidence": each.suspicion.evidence,
                "next": each.suspicion.next,
                "first_offset": min((t.offset for t in each.suspicion.troubles), default=0),
                "frames": [
                    {"offset": f.offset, "bytes": f.data, **({"right": f.right} if f.right else {})}
                    for f in each.suspicion.frames[:_MOST_FRAMES]
                ],
            }
            for each in self.causes
        ]


_EDGES = "the recording begins or ends within a frame"
_GROUP = "an address without any reply is moved alone and never read, as that of a group is"
_NOT_SENT = "requests stand in a text, without replies: nothing shows that they were sent"
_MOST_FRAMES = 20
#: Silent addresses that are a search.
_SEARCHED = 3
#: The share of the troubles that is most of them.
_MOST = 0.8
#: Replies from which on all went well for long, and troubles that are no chance.
_WELL, _FEWEST = 4, 2
#: What tells the frames of a capture apart: head and address, or unit and function.
_HEAD = 2
#: Rules of findings about what a frame says, and causes by which no drive answers.
_OF_CONTENT = frozenset(("failed_status", "refused_write", "modbus_exception", "out_of_range", "unknown_choice"))
_OF_SILENCE = frozenset(("wrong_address", "can_wrong_id", "no_reply"))


def suspected(scene: Scene) -> Iterator[Suspicion]:
    """Yield what all hypotheses suspect; each is told what those before it explain."""
    # The bytes of a program were not sent as they stand there.
    for hypothesis in _OF_PROGRAMS if scene.program else HYPOTHESES:
        # Of a dialect that is left out nothing is suspected.
        with contextlib.suppress(PluginError):
            for each in hypothesis(scene):
                scene.explained.update(each.troubles)
                if each.confidence is Confidence.CERTAIN:
                    scene.certain = max(scene.certain, len(set(each.troubles)))
                yield each


def diagnosis(watch: Watch, dialects: Sequence[Dialect]) -> Diagnosis:
    """Return what is wrong in a capture that a watch has seen."""
    return weighed(watch.scenes(dialects))


def weighed(scenes: Sequence[Scene]) -> Diagnosis:
    """Return what is wrong on some buses."""
    edges = frozenset(trouble for scene in scenes for trouble in _edges(scene))
    troubles = [trouble for scene in scenes for trouble in scene.troubles if trouble not in edges]
    # Why a drive is silent is told also of the last request.
    cut = {trouble for trouble in edges if trouble.rule not in SILENT}
    every = (each for scene in scenes for each in (*suspected(scene), *_since_trouble(scene)))
    suspicions = [each for each in every if not each.troubles or not cut.issuperset(each.troubles)]
    causes = tuple(ranked(suspicions, troubles))
    known = any(p.message is not None and p.message.command is not None for scene in scenes for p in scene.pieces)
    lost = sum(scene.lost for scene in scenes)
    groups = {trouble for scene in scenes for trouble in _to_groups(scene)}
    well = known and not lost and all((edges | groups).issuperset(scene.troubles) or _is_search(scene) for scene in scenes)
    count = len(troubles) + lost
    verdict = "trouble" if causes else "ok" if well else "unknown"
    return Diagnosis(verdict, causes, count, _unexplained(scenes, count), _EDGES if edges else _GROUP if groups else "")


def _since_trouble(scene: Scene) -> Iterator[Suspicion]:
    """Yield what is suspected from the first trouble on, where nothing certain is that explains most of the whole."""
    later = None if scene.certain >= _MOST * len(scene.troubles) else _later(scene)
    if later is None:
        return
    own = {(trouble.rule, trouble.offset): trouble for trouble in scene.troubles}
    for each in suspected(later):
        # Who answers at all the whole capture tells.
        if each.cause not in _OF_SILENCE:
            yield replace(each, troubles=[own.get((t.rule, t.offset), t) for t in each.troubles])


def _later(scene: Scene) -> Scene | None:
    """Return a bus from its first trouble on, where all went well for long before it, and little does since; else None.

    What is set wrongly from then on spoils all of this part, and little of the whole.
    """
    # A drive that refuses gets and sends frames as they should be.
    own = [trouble for trouble in scene.troubles if trouble.rule not in _OF_CONTENT]
    first = min((trouble.offset for trouble in own), default=0)
    asked = scene.asked_before(first)
    begins = asked is not None and (asked.stop == first or asked.sequence not in scene.replies)
    start = asked.offset if asked is not None and begins else first
    replies = [piece.offset for piece in scene.pieces if piece.is_reply and piece.sound]
    well = sum(offset < start for offset in replies)
    if well < _WELL or len(replies) - well > len(own) or len(own) < _FEWEST:
        return None
    pieces = [piece for piece in scene.pieces if piece.offset >= start]
    kept = {piece.sequence for piece in pieces}
    return dataclasses.replace(
        scene, pieces=pieces, reads=[read for read in scene.reads if read.stop > start],
        findings=[found for found in scene.findings if found.sequence in kept], frames=len(pieces), explained=set(), certain=0,
    )  # fmt: skip


def _unexplained(scenes: Sequence[Scene], troubles: int) -> str:
    """Return what can be said where no cause is named: bytes of others, or of a text, are no trouble of these drives."""
    if scenes and all(scene.program for scene in scenes):
        return _NOT_SENT
    sound = [(p, p.message) for scene in scenes for p in scene.pieces if p.sound and p.message is not None]
    if not troubles:
        return "no frame of a known dialect came, so nothing can be said of it"
    if not any(message.command is not None for _, message in sound):
        others = counted(troubles, "stretch of bytes", "stretches of bytes")
        return f"no frame of a known dialect came: {others} of something else, and no cause"
    if not any(piece.is_reply for piece, _ in sound) and all(scene.words and not scene.timed for scene in scenes):
        return _NOT_SENT
    what = counted(troubles, "thing")
    if all(message.command in (None, *message.frame.dialect.fallbacks.values()) for _, message in sound):
        return f"the frames are of no command of these drives; {what} among them cannot be explained"
    return f"{what} went wrong, and no cause shows in the bytes"


def _is_search(scene: Scene) -> bool:
    """Say whether all that is wrong is that addresses are silent, of which each was asked once, and others answer."""
    asked = [t.piece.message.address for t in scene.troubles if t.rule in SILENT and t.piece and t.piece.message]
    answers = any(piece.is_reply and piece.sound for piece in scene.pieces)
    return answers and len(asked) == len(scene.troubles) >= _SEARCHED and len(set(asked)) == len(asked)


def _to_groups(scene: Scene) -> Iterator[Trouble]:
    """Yield the silence of addresses that may be those of groups: others answer, and each is sent motions alone, each once.

    Of such a motion that is sent again a reply may be awaited; so it is where words ask.
    """
    if scene.words and not scene.noted:
        return
    sent: dict[int, list[Piece]] = {}
    for piece in scene.requests:
        if piece.message is not None:
            sent.setdefault(piece.message.address, []).append(piece)
    answers = {piece.message.address for piece in scene.pieces if piece.is_reply and piece.message is not None}
    for trouble in scene.of("silent_address"):
        message = trouble.piece.message if trouble.piece is not None else None
        if message is None or not answers or message.address in answers:
            continue
        own = sent.get(message.address, [])
        moves = all(p.message is not None and p.message.command is not None and p.message.command.silenced for p in own)
        if moves and len({p.data for p in own}) == len(own):
            yield trouble


def _edges(scene: Scene) -> Iterator[Trouble]:
    """Yield what is cut where a recording of a line begins and ends: it began to listen, and stopped, within a frame.

    So are a reply whose request came before, and a request whose reply came later. A log of reads or of sides shows what was
    sent as a whole.
    """
    sound = [piece for piece in scene.pieces if piece.sound]
    if scene.directed or any(read.firm for read in scene.reads) or sum(piece.is_reply for piece in sound) < _WELL:
        return
    asked = next((piece.offset for piece in sound if piece.is_request), 0)
    longest = max(len(piece.data) for piece in sound)
    for trouble in scene.troubles:
        stretch, piece = trouble.stretch, trouble.piece
        if stretch is None:
            first = trouble.rule == "unsolicited_reply" and piece is sound[0] and piece.stop == asked
            if first or (trouble.rule in SILENT and piece is scene.pieces[-1]):
                yield trouble
        elif stretch.offset == 0:
            heads = (other.data[:_HEAD] for other in sound)
            if stretch.stop == sound[0].offset < longest and stretch.data[:_HEAD] not in heads:
                yield trouble
        elif stretch.stop == scene.pieces[-1].stop:
            before = scene.asked_before(stretch.offset)
            awaits = before is not None and before.stop == stretch.offset
            if any(other.data.startswith(stretch.data) for other in sound) or (
                awaits and any(reply.begins(stretch.data) for reply in replies_to(before))
            ):
                yield trouble


def of_traffic(items: Iterable[Chunk | CanFrame], dialects: Sequence[Dialect]) -> Diagnosis:
    """Return what is wrong in traffic that is at hand."""
    watch = Watch()
    pipeline = Pipeline(dialects, [watch])
    for item in items:
        watch.take(item)
        pipeline.feed(item)
    pipeline.close()
    return diagnosis(watch, dialects)


def lines(found: Diagnosis) -> list[str]:
    """Return a diagnosis for people."""
    if found.verdict == "ok":
        return ["; ".join(filter(None, ("nothing wrong was found", found.remark)))]
    if not found.causes:
        return [found.unexplained]
    return [line for number, each in enumerate(found.causes, 1) for line in cause_lines(number, each)]


def cause_lines(number: int, each: Ranked) -> list[str]:
    """Return a cause for people."""
    suspicion = each.suspicion
    return [
        f"{number}. {suspicion.say} ({suspicion.cause}, {suspicion.confidence.value}, {each.share:.0%} of the trouble)",
        f"   evidence: {suspicion.evidence}",
        f"   next: {suspicion.next}",
    ]
