"""How the buses of a recording are to be read, from the events that say so: the same live and when the log is decoded again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.port import PortSetup
from analyzer.records import Event


class Setups:
    """Answers for `Pipeline.on_setup`. `dialects`: by name, as the wanted model speaks them."""

    def __init__(self, dialects: Mapping[str, Dialect]) -> None:
        self.dialects = dict(dialects)

    def __call__(self, event: Event) -> PortSetup | None:
        """Return what a bus is set up for from an event on, None where the event names no dialect.

        Raises UsageError for a dialect that there is none of here.
        """
        names = event.values.get("dialects")
        if not names:
            return None
        chosen = tuple(self.dialects.get(name) or registry.get(name) for name in names)
        byte_ns, offset = event.values.get("byte_ns"), event.values.get("offset", 0)
        return PortSetup(chosen, byte_ns if isinstance(byte_ns, int) else None, offset if isinstance(offset, int) else 0)


def as_model(model: str) -> dict[str, Dialect]:
    """Return every dialect by name, as a model speaks it. Raises UsageError for a model that none has."""
    return {d.name: d for d in registry.for_model(registry.every(), model or None)}


def names(dialects: Sequence[Dialect]) -> list[str]:
    """Return the names of dialects."""
    return [d.name for d in dialects]
