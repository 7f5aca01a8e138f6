"""What a whole run may send at most: commands, seconds, turns, and wear of the drive's flash.

    commands=500,seconds=600,turns=200,wear=20

Reads and stops cost nothing and always pass: they are what is left when the budget is spent. Seconds count from the first
command that does something. Several processes share one budget by a file, which each locks while it counts.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec

from analyzer.errors import UsageError
from analyzer.values import quote

try:
    import fcntl
except ImportError:  # no such locks: one process has the budget for itself
    fcntl = None  # type: ignore[assignment]

#: Environment of all processes of one run: the file in which its budget is counted.
FILE = "SERVOTAP_BUDGET_FILE"
#: Bytes of that file: what is spent, and blanks.
_ROOM = 256
#: How often the flash of a real drive may be worn, where a user says nothing else.
DEFAULT_WEAR = 50
SECOND_NS = 1_000_000_000


class Spent(msgspec.Struct):
    """What has been spent. `begun_ns`: when the first command left, None: none did."""

    commands: int = 0
    turns: float = 0.0
    wear: int = 0
    begun_ns: int | None = None


@dataclass(frozen=True)
class Cost:
    """What one sending costs. `commands` 0: a read or a stop. `turns` None: not known."""

    commands: int = 0
    turns: float | None = 0.0
    wear: int = 0

    @property
    def free(self) -> bool:
        """Whether it always passes."""
        return not self.commands


@dataclass
class Budget:
    """Limits and what is spent of them. None: no limit. `path`: the file that processes share, or None."""

    commands: int | None = None
    seconds: float | None = None
    turns: float | None = None
    wear: int | None = None
    path: Path | None = None
    spent: Spent = field(default_factory=Spent)

    def rehearsal(self) -> Budget:
        """Return a copy that shares nothing, to try out what a series of sendings would cost."""
        spent = self._load() if self.path is not None else self.spent
        return replace(self, path=None, spent=msgspec.structs.replace(spent))

    def refusal(self, cost: Cost, now_ns: int) -> str:
        """Return why a sending is beyond the budget, or nothing; nothing is spent."""
        return self._refusal(cost, now_ns, self._load() if self.path is not None else self.spent)

    def take(self, cost: Cost, now_ns: int) -> str:
        """Spend what a sending costs; return why it is beyond the budget, with nothing spent, or nothing."""
        with self._held() as spent:
            told = self._refusal(cost, now_ns, spent)
            spent.turns += 0.0 if told else cost.turns or 0.0
            if not told and not cost.free:
                spent.commands += cost.commands
                spent.wear += cost.wear
                if spent.begun_ns is None:
                    spent.begun_ns = now_ns
            return told

    def _refusal(self, cost: Cost, now_ns: int, spent: Spent) -> str:
        if cost.free:
            return ""
        if self.commands is not None and spent.commands + cost.commands > self.commands:
            return f"the budget of {self.commands} commands is spent"
        if self.seconds is not None and spent.begun_ns is not None:
            gone = (now_ns - spent.begun_ns) / SECOND_NS
            if gone > self.seconds:
                return f"the budget of {self.seconds:g} s is spent: the first command left {gone:.1f} s ago"
        if self.turns is not None and cost.turns is None:
            return f"how far it turns cannot be told, and there is a budget of {self.turns:g} turns"
        if self.turns is not None and spent.turns + (cost.turns or 0.0) > self.turns:
            left = max(0.0, self.turns - spent.turns)
            return f"{cost.turns or 0.0:.4g} turns, and of the budget of {self.turns:g} there are {left:.4g} left"
        if self.wear is not None and spent.wear + cost.wear > self.wear:
            return f"the budget of {self.wear} commands that wear the flash is spent (more: --budget wear=N)"
        return ""

    # --- the file ---------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _held(self) -> Iterator[Spent]:
        if self.path is None:
            yield self.spent
            return
        with self.path.open("r+b", buffering=0) as stream:
            if fcntl is not None:
                fcntl.flock(stream, fcntl.LOCK_EX)
            self.spent = _decoded(stream.read())
            yield self.spent
            stream.seek(0)
            # At one go and never shorter: a process that is killed here leaves what was spent before, or what is now.
            stream.write(msgspec.json.encode(self.spent).ljust(_ROOM))

    def _load(self) -> Spent:
        assert self.path is not None
        return _decoded(self.path.read_bytes())

    def described(self) -> dict[str, str]:
        """Return the limits as the option has them."""
        limits = {"commands": self.commands, "seconds": self.seconds, "turns": self.turns}
        shown = {name: f"{limit:g}" for name, limit in limits.items() if limit is not None}
        return shown | ({} if self.wear in (None, DEFAULT_WEAR) else {"wear": str(self.wear)})


def _decoded(data: bytes) -> Spent:
    return msgspec.json.decode(data, type=Spent) if data.strip() else Spent()


_WORDS = ("commands", "seconds", "turns", "wear")


def parse_budget(texts: list[str]) -> Budget:
    """Return the budget of `commands=500,seconds=600,turns=200` texts.

    Raises UsageError for what is none.
    """
    found: dict[str, float] = {}
    for part in (p.strip() for text in texts for p in text.split(",")):
        name, equals, value = part.partition("=")
        name = name.strip()
        if not equals or name not in _WORDS:
            raise UsageError(f"--budget: got {quote(part)}, expected {', '.join(f'{w}=N' for w in _WORDS)}")
        try:
            number = float(value)
        except ValueError:
            number = -1.0
        if not 0 <= number < 1e12:
            raise UsageError(f"--budget: {name}: got {quote(value)}, expected a number from 0 on")
        found[name] = number
    path = os.environ.get(FILE)
    commands = found.get("commands")
    return Budget(
        None if commands is None else int(commands),
        found.get("seconds"),
        found.get("turns"),
        int(found.get("wear", DEFAULT_WEAR)),
        Path(path) if path else None,
    )
