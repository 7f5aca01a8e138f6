"""Screens over the view: the help, and the question before a recording ends."""

from __future__ import annotations

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static


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
