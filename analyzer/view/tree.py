"""Leaves below the branches of their paths, as rows: what stands in a closed branch has no row."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")
Path = tuple[str, ...]


class TreeRow(NamedTuple, Generic[T]):
    """A branch, open or closed, or a leaf."""

    path: Path
    leaf: T | None
    open: bool = False

    def label(self, text: str = "") -> str:
        """Return the row's text, indented by its depth; a branch with a sign that says whether it is open."""
        depth = len(self.path) - (self.leaf is None)
        sign = "" if self.leaf is not None else "▾ " if self.open else "▸ "
        return "  " * depth + sign + (text or self.path[-1])


def rows(leaves: Iterable[tuple[Path, T]], is_open: Callable[[Path], bool]) -> list[TreeRow[T]]:
    """Return the rows of leaves that come in order, each with the path of its branch."""
    found: list[TreeRow[T]] = []
    before: Path = ()
    for path, leaf in leaves:
        for depth in range(len(path)):
            branch = path[: depth + 1]
            if branch != before[: depth + 1] and all(is_open(path[:above]) for above in range(1, depth + 1)):
                found.append(TreeRow(branch, None, is_open(branch)))
        before = path
        if all(is_open(path[: depth + 1]) for depth in range(len(path))):
            found.append(TreeRow(path, leaf))
    return found
