"""Inputs, and the folder of those that showed a fault once.

    corpus/TARGET/NAME            a file: the bytes of the input
    corpus/TARGET/NAME/...        a folder: an input of several files, by their paths in it

An input of a target with one file has it under the name `INPUT`. To add one, copy it there: `make test` replays all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from tests import CAPTURES

#: Files by their path.
Input = Mapping[str, bytes]
INPUT = "input"
FOLDER = Path(__file__).parent / "corpus"


def load(path: Path) -> Input:
    """Return an entry of the corpus."""
    if path.is_dir():
        return {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}
    return {INPUT: path.read_bytes()}


def save(given: Input, path: Path) -> None:
    """Write an input: one file as a file, several as a folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if list(given) == [INPUT]:
        path.write_bytes(given[INPUT])
    else:
        lay_out(given, path)


def lay_out(given: Input, folder: Path) -> None:
    """Write the files of an input into a folder."""
    for name, data in given.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def entries(target: str, folder: Path = FOLDER) -> Iterator[tuple[str, Input]]:
    """Yield the entries of a target with their names, in order."""
    place = folder / target
    for path in sorted(place.iterdir()) if place.is_dir() else ():
        yield path.name, load(path)


def quick(target: str) -> list[Input]:
    """Return the entries of a target that mutations begin with: all but those that are replayed alone, as they take long."""
    return [given for name, given in entries(target) if not name.endswith(".slow")]


def captures() -> list[bytes]:
    """Return the captures of this project that are small and quick to read; MF4 takes a process for each."""
    paths = sorted(p for p in CAPTURES.iterdir() if p.is_file() and p.suffix not in (".py", ".md", ".golden", ".mf4"))
    return [p.read_bytes() for p in paths]
