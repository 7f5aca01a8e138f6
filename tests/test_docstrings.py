"""What a docstring says of a member or an argument by its name is there: names that were changed or dropped are found."""

from __future__ import annotations

import ast
import re

from tests.test_layers import MODULES

#: Names at the begin of a clause, then a colon, maybe behind the one value that is told: "`a`, `b`: ...", "`a` False: ...".
CLAUSE = re.compile(r"(?:^|[.;)]\s+|\n\s*)((?:`\w+`(?:, | and | or )?)+)(?: (?:[A-Z]\w+|\d+))?: ")


def known(node: ast.AST, classes: dict[str, list[ast.ClassDef]], seen: frozenset[str] = frozenset()) -> set[str]:
    """Return all names and words within a class or a function; of a class those of its bases, too."""
    found = {"None"}
    for each in ast.walk(node):
        match each:
            case ast.Name(name) | ast.Attribute(attr=name) | ast.arg(arg=name) | ast.FunctionDef(name=name):
                found.add(name)
            case ast.Constant(str(text)) if text.isidentifier():
                found.add(text)
    for base in node.bases if isinstance(node, ast.ClassDef) else ():
        inner = base.value if isinstance(base, ast.Subscript) else base
        name = getattr(inner, "id", getattr(inner, "attr", ""))
        for other in classes.get(name, ()):
            if other is not node and name not in seen:
                found |= known(other, classes, seen | {name})
    return found


def told(docstring: str) -> list[str]:
    """Return the names that a docstring explains."""
    return [name for names in CLAUSE.findall(docstring) for name in re.findall(r"`(\w+)`", names)]


def test_names_are_found_where_they_are_explained():
    text = "A thing. `one`: first; `two`, `three`: more, of `four`.\n\n`five` False: last. It asks `six`: seven."
    assert told(text) == ["one", "two", "three", "five"]


def test_what_is_explained_is_there():
    explained = 0
    lost = []
    nodes = [
        (module, node)
        for module, path in MODULES.items()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.ClassDef, ast.FunctionDef))
    ]
    classes: dict[str, list[ast.ClassDef]] = {}
    for _, node in nodes:
        if isinstance(node, ast.ClassDef):
            classes.setdefault(node.name, []).append(node)
    for module, node in nodes:
        if names := told(ast.get_docstring(node) or ""):
            explained += len(names)
            within = known(node, classes)
            lost += [(module, node.name, name) for name in names if name not in within]
    assert explained > 1000
    assert lost == []
