"""The findings, newest last, with their counts by rule and the causes of trouble above."""

from __future__ import annotations

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.widgets import Static

from analyzer.live.snapshot import FindingLine
from analyzer.sources.times import ShownTime
from analyzer.values import printable
from analyzer.view.lines import SEVERITIES
from analyzer.view.rows import Rows
from analyzer.view.watch import Watch


class FindingRows(Rows):
    """Rows of findings."""

    follows = True

    def __init__(self, watch: Watch, times: ShownTime, live: bool) -> None:
        super().__init__(id="finding_rows")
        self._watch = watch
        self._times = times
        self.following = self.follows = live

    @property
    def chosen(self) -> FindingLine | None:
        kept = self._watch.findings
        return kept.item(self.cursor) if kept.first <= self.cursor < kept.stop else None

    def bounds(self) -> tuple[int, int]:
        return self._watch.findings.first, self._watch.findings.stop

    def heading(self, width: int) -> Text:
        return Text(f"  {f'time {self._times.zone}'.rstrip():>15} {'bus':<8} {'addr':>5} finding", style="bold", no_wrap=True)

    def row(self, number: int, width: int) -> Text:
        found = self._watch.findings.item(number)
        letter, colour = SEVERITIES.get(found.severity, (" ", ""))
        text = Text(no_wrap=True)
        text.append(f"{letter} ", colour)
        text.append(f"{self._times.text(found.t_ns):>15} {printable(found.bus)[:8]:<8} {printable(found.who):>5} ")
        text.append(f"{printable(found.rule)}: ", colour)
        text.append(printable(found.text))
        return text


def finding_text(found: FindingLine) -> Text:
    """Return a finding in full."""
    letter, colour = SEVERITIES.get(found.severity, (" ", ""))
    text = Text()
    text.append(f"{letter} {printable(found.rule)}: {printable(found.text)}", colour)
    if found.section:
        text.append(f" (section {printable(found.section)})")
    if found.sequence:
        text.append(f"  frame {found.sequence}, {printable(found.topic)}, offset {found.offset}", "dim")
    return text


class FindingsPanel(Vertical):
    """Counts by rule with the causes of trouble, the findings, and below them the one under the cursor in full."""

    def __init__(self, watch: Watch, times: ShownTime, live: bool) -> None:
        super().__init__(id="findings")
        self._watch = watch
        self._live = live
        self.rows = FindingRows(watch, times, live)
        self._counts = Static(id="rules", markup=False)
        self._text = Static(markup=False)

    def compose(self) -> ComposeResult:
        yield self._counts
        yield self.rows
        yield self._text

    def on_rows_moved(self) -> None:
        self._whole()

    def _whole(self) -> None:
        found = self.rows.chosen
        self._text.update("" if found is None else finding_text(found))

    def sync(self) -> None:
        self._counts.update(self._rules())
        self.rows.sync()
        self._whole()

    def _rules(self) -> Text:
        rules = sorted(self._watch.rules.items(), key=lambda item: -item[1])
        causes = "".join(f"\n{printable(line)}" for lines in self._watch.causes.values() for line in lines)
        if not rules:
            return Text("no findings")
        text = "  ".join(f"{printable(rule)} {count}" for rule, count in rules)
        listed = self._watch.findings.stop - self._watch.findings.first
        total = sum(self._watch.rules.values())
        if listed < total:
            text += f"   ({listed} of {total} are listed: {'the newest that were shown' if self._live else 'the first'})"
        return Text(text + causes)
