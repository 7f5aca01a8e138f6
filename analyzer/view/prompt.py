"""The prompt: a line for a filter, a search text or a note."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.message import Message
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
        """Ask for something, with a text to begin with."""
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
