"""What is asked and told over the view: the line for a filter, a search text or a note, the help, the question at the end."""

from __future__ import annotations

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal, VerticalScroll
from textual.message import Message
from textual.screen import ModalScreen
from textual.widgets import Input, Static
from textual.widgets.input import Selection

FILTER, SEARCH, MARK = "filter", "search", "mark"
_HINTS = {
    FILTER: 'such as  address == 1 and command == "read_speed"  (empty: all)',
    SEARCH: "a text: part of a name, a value, hex bytes",
    MARK: "a note for the log",
}


class Prompt(Horizontal):
    """One line that is there while something is asked for. `asking`: what, empty for nothing."""

    DEFAULT_CSS = """
    Prompt { height: 1; display: none; }
    Prompt Static { width: auto; }
    Prompt Input { width: 1fr; padding: 0 1; }
    """

    class Given(Message):
        """A text was given."""

        def __init__(self, what: str, text: str) -> None:
            super().__init__()
            self.what = what
            self.text = text

    def __init__(self) -> None:
        super().__init__(id="prompt")
        self.asking = ""
        self._label = Static(markup=False)
        self._input = Input(id="prompt_text")
        # Set here and not by a rule: the border that Textual gives a focused input would fill its only row.
        self._input.styles.border = ("none", "transparent")
        self._input.styles.height = 1

    def compose(self) -> ComposeResult:
        yield self._label
        yield self._input

    def ask(self, what: str, text: str) -> None:
        self.asking = what
        self._label.update(f"{what}:")
        self._input.placeholder = _HINTS[what]
        self._input.value = text
        self.display = True
        self._input.focus()

    def ask_again(self) -> None:
        """Mark the text that was wrong: what is typed next takes its place, the cursor keys edit it."""
        self._input.selection = Selection(0, len(self._input.value))

    def close(self) -> None:
        self.asking = ""
        self.display = False

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self.post_message(self.Given(self.asking, event.value.strip()))


class HelpScreen(ModalScreen[None]):
    """The keys. Any key that means away closes it."""

    DEFAULT_CSS = """
    HelpScreen { align: center middle; }
    HelpScreen > VerticalScroll { width: 100%; max-width: 110; height: auto; max-height: 100%; border: solid $primary;
        background: $surface; padding: 0 1; }
    """
    BINDINGS = [Binding("escape,q,question_mark,h,f1,enter,space", "dismiss", "Close")]  # noqa: RUF012 (as textual has it)

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        with VerticalScroll():
            yield Static(Text(self._text), markup=False)


class EndQuestion(ModalScreen[bool]):
    """Asks whether the recording is to end."""

    DEFAULT_CSS = """
    EndQuestion { align: center middle; }
    EndQuestion > Static { width: auto; border: solid $primary; background: $surface; padding: 1 2; }
    """
    BINDINGS = [  # noqa: RUF012 (as textual has it)
        Binding("y,enter", "answer(True)", "Yes"),
        Binding("n,escape,q", "answer(False)", "No"),
    ]

    def compose(self) -> ComposeResult:
        yield Static(Text("End the recording?  y ends it, n continues"), markup=False)

    def action_answer(self, yes: bool) -> None:
        self.dismiss(yes)
