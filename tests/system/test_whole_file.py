"""Small files that users name: any content, even a wrong one, soon gets a message."""

from __future__ import annotations

from pathlib import Path

import pytest

from analyzer.errors import ServotapError
from analyzer.live import profile
from conformance.report import baseline
from conformance.safety import journal, settings
from conformance.serve import state

LOADERS = {
    "profile": lambda path: profile._File(path),
    "baseline": baseline.load,
    "settings": settings.load,
    "journal": journal.read,
    "state": lambda path: state.load(str(path)),
}
HOSTILE = {
    "bytes": b"\x00\xff\xfe\x1b[2J\n\x00",
    "deep lists": b"a = " + b"[" * 100_000 + b"\n\n",
    "deep": b"[" * 100_000 + b"\n\n",
    "deep objects": b'{"a":' * 100_000 + b"\n\n",
    "huge numbers": b'{"servotap": "drives", "version": 1e999, "a": ' + b"9" * 5000 + b"}\n\n",
    "no UTF-8": b'{"a": "\xff\xfe"}\n\n',
}


@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.parametrize("loader", LOADERS)
def test_hostile_files(loader, what, tmp_path):
    path = tmp_path / "file"
    path.write_bytes(HOSTILE[what])
    with pytest.raises(ServotapError) as refused:
        LOADERS[loader](path)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize("loader", LOADERS)
@pytest.mark.parametrize("place", ["/dev/zero", "folder", "loop"])
def test_what_is_no_file(loader, place, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(ServotapError):
        LOADERS[loader](tmp_path / place if not Path(place).is_absolute() else Path(place))
