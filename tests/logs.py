"""Whole logs, as tests read them: by the `mcap` library, not by the project's own readers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mcap.reader import make_reader


def messages(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Return topic and content of all messages; fail where the log is not whole."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        found = [(channel.topic, json.loads(message.data)) for _, channel, message in reader.iter_messages()]
        assert summary.statistics.message_count == len(found)
        return found


def metadata(path: Path, name: str = "servotap") -> dict[str, str]:
    """Return the last metadata of a name."""
    with path.open("rb") as stream:
        return [found.metadata for found in make_reader(stream).iter_metadata() if found.name == name][-1]
