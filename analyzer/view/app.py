"""The terminal view: panels that keys switch, a head that is always visible, and a prompt.

Ten times a second it takes new records, draws the visible ones, and continues a filter, a search or a plot by a small step.
This work is bounded: under load the view shows less but keeps up.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

from textual.app import App, ComposeResult
from textual.containers import Vertical
from textual.widgets import ContentSwitcher, Footer, Static

from analyzer.cli.filter import vocabulary
from analyzer.errors import ServotapError, UsageError
from analyzer.live.snapshot import FrameLine
from analyzer.values import counted, printable
from analyzer.view.condition import Condition
from analyzer.view.counts_panel import CountsPanel
from analyzer.view.details_panel import Details, DetailsPanel
from analyzer.view.findings_panel import FindingsPanel
from analyzer.view.frames_panel import FramesPanel
from analyzer.view.head import head_text
from analyzer.view.keys import bindings, help_text
from analyzer.view.plot_panel import PlotPanel
from analyzer.view.prompt import FILTER, MARK, SEARCH, EndQuestion, HelpScreen, Prompt
from analyzer.view.rows import Rows
from analyzer.view.search import Seeker
from analyzer.view.source import ViewSource
from analyzer.view.terminal import EndingSignals, forgiving_terminal, terminal_watch
from analyzer.view.watch import number_of

#: Seconds between two looks at what is new, and how long one look may take for each thing that is asked for.
PERIOD = 0.1
SHARE = 0.05
#: Why it ends when its terminal does.
GONE = "its terminal has gone"


class ViewApp(App[str]):
    """The view of a source."""

    ENABLE_COMMAND_PALETTE = False
    CSS = """
    #head { height: auto; }
    #switch { height: 1fr; }
    #frames_box, #findings { height: 1fr; }
    #rules { height: auto; max-height: 11; }
    #chart { width: 1fr; height: 1fr; }
    #status { height: auto; min-height: 1; max-height: 3; }
    """

    def __init__(self, source: ViewSource, *, filter_text: str = "", signals: EndingSignals | None = None) -> None:
        super().__init__()
        self._signals = signals
        self.title = "servotap view"
        self.source = source
        self.frames = FramesPanel(source)
        self.counts = CountsPanel(source.watch)
        self.findings = FindingsPanel(source.watch, source.times, source.live)
        self.plot = PlotPanel(source)
        self.details = DetailsPanel()
        # Kept by name: while the help lies over the view, a query would look for them there.
        self._head = Static(id="head", markup=False)
        self._switch = ContentSwitcher(initial="frames_box", id="switch")
        self._status = Static(id="status", markup=False)
        self._prompt = Prompt()
        self._focus: dict[str, Rows] = {
            "frames": self.frames, "counts": self.counts, "findings": self.findings.rows, "plot": self.plot.rows,
        }  # fmt: skip
        self._details = Details(source.dialects, source.times)
        self._known = vocabulary(source.dialects)
        self._filter_text = filter_text
        self._paused = False
        self._waiting = 0
        self._seeker = Seeker()
        self._said = source.note
        self._terminal_gone = terminal_watch()
        self._stale = True
        for binding in bindings(source.live):
            self._bindings.bind(
                binding.key, binding.action, binding.description, binding.show, binding.key_display, binding.priority
            )

    @property
    def failed(self) -> Exception | None:
        """The error that ended the view."""
        return self._exception

    def _print_error_renderables(self) -> None:
        """Print nothing: the command reports the error."""
        self._exit_renderables.clear()

    def compose(self) -> ComposeResult:
        yield self._head
        with self._switch:
            with Vertical(id="frames_box"):
                yield self.frames
                yield self.details
            yield self.counts
            yield self.findings
            yield self.plot
        yield self._status
        yield self._prompt
        footer = Footer()
        footer.compact = True
        yield footer

    def on_mount(self) -> None:
        self.frames.focus()
        if self._filter_text:
            self._set_filter(self._filter_text)
        if self._signals is not None:
            self._signals.on(lambda: self.exit("quit"))
        self.set_interval(PERIOD, self.tick)
        self.tick()

    # --- what comes -----------------------------------------------------------------------------------------------

    def tick(self) -> None:
        if self._terminal_gone():
            self.exit(GONE)
            return
        changed = self.source.take() or self._stale
        self._stale = False
        if self._paused:
            self._waiting = self.source.pause(True)
        wanted = self.frames.wanted
        if wanted is not None and not wanted.done:
            wanted.look(SHARE)
            changed = True
        if self._seeker.search is not None:
            self._look()
            changed = True
        shown = self.shown
        if shown == "plot":
            self.plot.moment_ns = None if self.source.live or self.frames.line is None else self.frames.line.t_ns
            self.plot.sync(SHARE)
        elif changed:
            panels: dict[str, Rows | FindingsPanel] = {
                "frames": self.frames, "counts": self.counts, "findings": self.findings,
            }  # fmt: skip
            panels[shown].sync()
        if changed:
            head = head_text(self.source, self.size.width, paused=self._paused, waiting=self._waiting)
            self._head.update(head)
            self._tell()
        if self.source.live and self.source.done:
            self.exit("ended")

    @property
    def shown(self) -> str:
        current = self._switch.current
        return "frames" if current in (None, "frames_box") else str(current)

    def _tell(self) -> None:
        words = [self._said] if self._said else []
        wanted = self.frames.wanted
        if wanted is not None:
            lines = self.source.lines
            how = "" if wanted.done else f" ({100 * wanted.looked // max(1, lines.stop)} % searched)"
            words.append(f"{counted(wanted.stop - wanted.first, 'frame')} shown{how}: {self._filter_text}")
        search = self._seeker.search
        if search is not None:
            words.append(f"looking for {search.what}: {search.place}  (Esc stops)")
        missed = self.source.watch.missed
        if missed and self.source.live:
            words.append(f"{counted(missed, 'snapshot')} missed: the view is slower than the bus")
        if self.source.broken:
            words.append(self.source.broken)
        if self.shown == "counts":
            words.append(f"by {self.counts.order}")
        self._status.update(printable("   ".join(words)))

    def say(self, text: str) -> None:
        self._said = text
        self._tell()

    # --- panels ---------------------------------------------------------------------------------------------------

    def action_panel(self, name: str) -> None:
        self._switch.current = "frames_box" if name == "frames" else name
        self._focus[name].focus()
        self._stale = True
        self.call_after_refresh(self.tick)

    def on_rows_moved(self, event: Rows.Moved) -> None:
        if event.rows is self.frames and self.details.display:
            self._show_details()

    def on_rows_chosen(self, event: Rows.Chosen) -> None:
        """Do what Enter means in this panel."""
        if event.rows is self.frames:
            self.action_details()
        elif event.rows is self.findings.rows:
            found = self.findings.rows.chosen
            if found is not None:
                self._go_to(found.sequence)
        elif event.rows is self.plot.rows:
            self.plot.rows.toggle()
            self.plot.sync()
        elif event.rows is self.counts and self.counts.chosen is not None:
            row = self.counts.chosen
            name = "unknown" if row.command.startswith("unknown") else row.command
            text = f'bus == "{row.bus}" and command == "{name}"'
            if number_of(row.who) >= 0:
                text += f" and address == {row.who}"
            if self._set_filter(text):
                self.action_panel("frames")
        elif event.rows is self.counts:
            self.counts.toggle()

    def action_details(self) -> None:
        if self.shown != "frames":
            self.action_panel("frames")
        self.details.display = not self.details.display
        if self.details.display:
            self._show_details()
        self.call_after_refresh(self.frames.sync)

    def _show_details(self) -> None:
        line = self.frames.line
        if line is None:
            return
        request = self._line_of(line.request_sequence)
        findings = self.source.watch.findings_of(line.sequence)
        self.details.show(self._details.text(line, request, findings))

    def _line_of(self, sequence: int | None) -> FrameLine | None:
        number = self.source.lines.number_of(sequence) if sequence else None
        return None if number is None else self.source.lines.line(number)

    def action_scroll_details(self, step: int) -> None:
        self.details.scroll_relative(y=step * 4, animate=False)

    def _go_to(self, sequence: int) -> None:
        """Show a frame by its sequence, without a filter if that hides it."""
        number = self.frames.lines.number_of(sequence) if sequence else None
        if number is None and self.frames.wanted is not None and self.source.lines.number_of(sequence) is not None:
            self._clear_filter()
            number = self.frames.lines.number_of(sequence)
        if number is None:
            self.say(f"frame {sequence} is no longer among the lines; it is in the log")
            return
        self.action_panel("frames")
        self.frames.put(number)

    # --- keys -----------------------------------------------------------------------------------------------------

    def action_pause(self) -> None:
        self._paused = not self._paused
        self._waiting = self.source.pause(self._paused)
        self._stale = True
        self.tick()

    def action_shows(self) -> None:
        self.say(f"showing {self.frames.columns.next_shows(self.frames.size.width - 1)}")
        self.frames.sync()

    def action_time(self) -> None:
        names = {
            "clock": f"time of day {self.source.times.zone}".rstrip(),
            "elapsed": "seconds since the first frame",
            "step": "seconds since above",
        }
        self.say(names[self.frames.columns.next_time()])
        self.frames.sync()

    def action_order(self) -> None:
        self.counts.next_order()
        self._tell()

    def action_zoom(self, step: int) -> None:
        self.say(f"plot: {self.plot.zoom(step)}")

    def action_keys(self) -> None:
        self.push_screen(HelpScreen(help_text(self.source.live)))

    def action_step_back(self) -> None:
        """Leave what is under way: the line to type in, a search, the details, the filter; one at a time."""
        if self._prompt.asking:
            self._close_prompt()
        elif self._seeker.search is not None:
            self._seeker.search = None
        elif self.shown == "plot" and self.plot.no_cursor():
            pass
        elif self.details.display:
            self.details.display = False
        elif self.frames.wanted is not None:
            self._clear_filter()
        self._said = ""
        self._stale = True
        self.call_after_refresh(self.tick)

    def action_leave(self) -> None:
        if self.source.live and not self.source.done:
            self.push_screen(EndQuestion(), lambda yes: self.exit("quit") if yes else None)
        else:
            self.exit("quit")

    async def action_quit(self) -> None:
        """End the view, as `q` does."""
        self.action_leave()

    def action_stop(self) -> None:
        self.exit("quit")

    # --- the line to type in --------------------------------------------------------------------------------------

    def action_filter(self) -> None:
        self._prompt.ask(FILTER, self._filter_text)

    def action_search(self) -> None:
        self._prompt.ask(SEARCH, self._seeker.text)

    def action_mark(self) -> None:
        self._prompt.ask(MARK, "")

    def _close_prompt(self) -> None:
        self._prompt.close()
        self._focus[self.shown].focus()

    def on_prompt_given(self, event: Prompt.Given) -> None:
        """Do what was asked for; a filter that cannot be stays to be mended."""
        if not event.what or event.what != self._prompt.asking:
            # The key was pressed again before the answer to the first was dealt with.
            return
        done = {FILTER: self._set_filter, SEARCH: self._set_search, MARK: self._set_mark}[event.what](event.text)
        if done:
            self._close_prompt()
            if event.what != MARK and self.shown != "frames":
                self.action_panel("frames")
        else:
            self._prompt.ask_again()
        self._stale = True

    def _set_mark(self, text: str) -> bool:
        if text:
            try:
                self.say(self.source.mark(text) or f"marked: {text}")
            except ServotapError as error:
                self.say(str(error))
        return True

    def _set_filter(self, text: str) -> bool:
        if not text:
            self._clear_filter()
            return True
        try:
            condition = Condition(text, self._known)
        except UsageError as error:
            self.say(str(error))
            return False
        self._filter_text = text
        self._said = ""
        lines = self.source.wanted(condition)
        lines.look(SHARE)
        self.frames.look(lines)
        return True

    def _clear_filter(self) -> None:
        self._filter_text = ""
        self.frames.look(None)

    # --- searches -------------------------------------------------------------------------------------------------

    def _set_search(self, text: str) -> bool:
        self._seeker.text = text
        if text:
            self.action_again(1)
        return True

    def action_again(self, step: int) -> None:
        if not self._seeker.text:
            self.say("no search yet: press / to enter a text")
            return
        self._seek(lambda: self._seeker.for_text(self.frames.lines, self.frames.cursor, step))

    def action_finding(self, step: int) -> None:
        hop = self.source.hop if self.frames.wanted is None else None
        self._seek(lambda: self._seeker.for_finding(self.frames.lines, self.frames.cursor, step, hop))

    def _seek(self, begin: Callable[[], None]) -> None:
        if self.shown != "frames":
            self.action_panel("frames")
        self._said = ""
        begin()
        self._look()

    def _look(self) -> None:
        search = self._seeker.look(SHARE)
        if search is None:
            return
        if search.found is not None and search.lines is self.frames.lines:
            self.frames.put(search.found)
            self.say("")
            return
        more = "" if self.source.done or self.source.live else " so far"
        self.say(f"{search.what}: none {'below' if search.step > 0 else 'above'}{more}")
        self.bell()


def run(source: ViewSource, *, filter_text: str = "") -> str:
    """Run the view until it ends; return `quit`, `ended`, or why it could not go on. Raises what failed in it."""
    # The supervisor of a recording has its own handlers.
    with forgiving_terminal(), nullcontext() if source.live else EndingSignals() as signals:
        app = ViewApp(source, filter_text=filter_text, signals=signals)
        result = app.run()
    if app.failed is not None:
        raise app.failed
    return result or "quit"
