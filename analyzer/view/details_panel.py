"""One frame byte by byte: what each bit means, whether the checksum fits, and the findings about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.widgets import Static

from analyzer.catalogue import Dialect, Role
from analyzer.errors import ServotapError
from analyzer.live.snapshot import EVENT, FOREIGN, JUNK, FindingLine, FrameLine
from analyzer.reference.explanation import Explainer
from analyzer.reference.explanation_text import explanation_lines
from analyzer.reference.hex_frame import Given
from analyzer.sources.times import ShownTime
from analyzer.values import SECOND_NS, counted, fields_text, printable
from analyzer.view.findings_panel import finding_text
from analyzer.view.lines import SEVERITIES, bytes_text

_BYTES_A_ROW = 16
_ROLES = {"request": Role.REQUEST, "reply": Role.REPLY}


class Details:
    """Explains lines in some dialects; keeps an explainer for each."""

    def __init__(self, dialects: Sequence[Dialect], times: ShownTime) -> None:
        self._times = times
        self._dialects = {d.name: d for d in dialects}
        self._explainers: dict[str, Explainer] = {}

    def text(self, line: FrameLine, request: FrameLine | None, findings: Sequence[FindingLine]) -> Text:
        """Return all that is known of a line; `request`: the one it answers, where it is still there."""
        text = Text()
        for found in findings:
            text.append_text(finding_text(found))
            text.append("\n")
        missing = [rule for rule in line.rules if rule not in {f.rule for f in findings}]
        if missing:
            text.append(f"! {', '.join(missing)}\n", SEVERITIES.get(line.severity, ("", ""))[1])
        if line.role == EVENT:
            text.append(f"{printable(line.command)}: {printable(line.text)}\n")
        elif line.role == Role.MESSAGE:
            # Where its signals stand, the reader of the file knows alone.
            text.append(f"{printable(line.command)}\n{bytes_text(line)}\n{printable(fields_text(line.values, line.units))}\n")
        elif line.role in (JUNK, FOREIGN) or line.dialect not in self._dialects:
            self._bytes(text, line)
        else:
            self._explained(text, line, request, {f.rule for f in findings})
        text.append(self._place(line), "dim")
        return text

    def _place(self, line: FrameLine) -> str:
        words = [self._times.text(line.t_ns), printable(line.bus)]
        if line.sequence:
            words += [f"sequence {line.sequence}", f"offset {line.offset}"]
        if line.topic:
            words.append(printable(line.topic))
        if line.latency_ns is not None:
            words.append(f"latency {line.latency_ns / SECOND_NS * 1e3:.3f} ms")
        if line.request_sequence is not None:
            words.append(f"answers {line.request_sequence}")
        return "  ".join(words)

    @staticmethod
    def _bytes(text: Text, line: FrameLine) -> None:
        text.append(f"{printable(line.command)}, {counted(line.values.get('length', len(line.raw.split())), 'byte')}\n")
        data = line.raw.split()
        for at in range(0, len(data), _BYTES_A_ROW):
            text.append(f"{at:>5}  {' '.join(data[at : at + _BYTES_A_ROW])}\n")

    def _explained(self, text: Text, line: FrameLine, request: FrameLine | None, told: set[str]) -> None:
        explainer = self._explainers.get(line.dialect)
        if explainer is None:
            explainer = self._explainers[line.dialect] = Explainer((self._dialects[line.dialect],))
        try:
            found = explainer.explain(
                _given(line), role=_ROLES.get(line.role, Role.UNKNOWN), request=None if request is None else _given(request)
            )
        except ServotapError as error:
            text.append(f"{bytes_text(line)}\n{printable(fields_text(line.values, line.units))}\n")
            text.append(printable(str(error).split("\n")[-1].strip()), "dim")
            return
        found = replace(found, issues=tuple(issue for issue in found.issues if issue.rule not in told))
        for row in explanation_lines(found):
            if row in ("", "no findings"):
                continue
            # Colours are put in where standard output is a terminal; only those are taken over.
            part = Text.from_ansi(row)
            part.plain = printable(part.plain)
            text.append_text(part)
            text.append("\n")
        if line.request_sequence is not None and request is None:
            text.append("its request is no longer among the lines; decoded without it\n", "dim")


def _given(line: FrameLine) -> Given:
    return Given(bytes.fromhex(line.raw), line.can_id)


class DetailsPanel(VerticalScroll):
    """The details of the line under the cursor."""

    DEFAULT_CSS = "DetailsPanel { height: 60%; border-top: solid $primary; display: none; }"

    def __init__(self) -> None:
        super().__init__(id="details")
        self._text = Static(markup=False)

    def compose(self) -> ComposeResult:
        yield self._text

    def show(self, text: Text) -> None:
        """Show a text from its beginning."""
        self._text.update(text)
        self.scroll_home(animate=False)
