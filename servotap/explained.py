"""What `servotap.explain` returns: the frames of some bytes, and the text that the command line prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.cli.explain import explained as as_object
from analyzer.errors import UsageError
from analyzer.reference.explanation import Explainer, Explanation
from analyzer.reference.explanation_text import explanation_lines
from analyzer.reference.hex_frame import Given, read_frame
from servotap.arguments import check


@dataclass(frozen=True, repr=False)
class Explained:
    """One frame or several that stand behind each other. It prints as `servotap explain` does."""

    frames: tuple[Explanation, ...]

    def __str__(self) -> str:
        return "\n\n".join("\n".join(explanation_lines(frame)) for frame in self.frames)

    __repr__ = __str__

    @property
    def dialect(self) -> str:
        """The dialect of the first frame."""
        return self.frames[0].dialect.name

    @property
    def command(self) -> str:
        """The command of the first frame, empty for an unknown one."""
        command = self.frames[0].message.command
        return "" if command is None else command.name

    @property
    def findings(self) -> list[str]:
        """The rules that the frames break."""
        return [issue.rule for frame in self.frames for issue in frame.issues]

    def as_objects(self) -> list[dict[str, Any]]:
        """Return the frames as `servotap explain --json` has them."""
        return [as_object(frame) for frame in self.frames]


def explain(
    frame: str | bytes,
    *,
    dialect: str | None = None,
    role: str | None = None,
    model: str | None = None,
    request: str | bytes | None = None,
    no_checksum: bool = False,
) -> Explained:
    """Explain a frame byte by byte: hex as `servotap explain` takes it, or the bytes themselves.

    `request`: what this frame answers. Raises UsageError; UnreadableError where no dialect reads it.
    """
    check(frame=frame, request=request)
    if dialect is not None:
        check(dialect=dialect)
    check(model=model)
    if role not in (None, "request", "reply"):
        raise UsageError(f"role: got {role!r}, expected 'request' or 'reply'")
    explainer = Explainer(registry.asked_for(dialect, model))
    asked = None if request is None else _given(request)
    of = Role(role) if role else Role.UNKNOWN
    if isinstance(frame, str):
        return Explained(tuple(explainer.text(frame, role=of, no_checksum=no_checksum, request=asked)[0]))
    return Explained(tuple(explainer.each(Given(bytes(frame)), role=of, no_checksum=no_checksum, request=asked)))


def _given(frame: str | bytes) -> Given:
    return read_frame(frame) if isinstance(frame, str) else Given(bytes(frame))
