"""What is read of others may be anything: no place that reads it leaves one kind of error out."""

from __future__ import annotations

import ast

import msgspec
import pytest

from analyzer.system.decoding import UNDECODABLE
from tests.test_layers import MODULES

#: What decoding alone raises; `ValidationError` comes from `convert`, too, where no bytes are read.
DECODING = {"msgspec.MsgspecError", "msgspec.DecodeError"}


@pytest.mark.parametrize(
    "data", [b"", b"{", b'{"a": 1}', b'{"a": "\xff"}', b"[" * 100_000, b'{"b":' * 100_000, b'{"a":' + b"[" * 100_000]
)
def test_whatever_stands_there_is_undecodable(data):
    with pytest.raises(UNDECODABLE):
        msgspec.json.decode(data, type=dict[str, str])


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x91" * 5000, b"\x81\xa1a" * 5000, b"\x81\xa1\xff\x01"])
def test_so_is_what_is_no_messagepack(data):
    with pytest.raises(UNDECODABLE):
        msgspec.msgpack.decode(data, type=dict[str, str])


def caught(tree):
    """What the `except`s and `suppress`es of a module name."""
    for node in ast.walk(tree):
        named = []
        if isinstance(node, ast.ExceptHandler) and node.type is not None:
            named = [node.type]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) == "suppress":
            named = node.args
        for each in named:
            yield from (ast.unparse(part) for part in ast.walk(each) if isinstance(part, (ast.Name, ast.Attribute)))


def test_nobody_names_some_of_these_errors_and_forgets_another():
    trees = {name: ast.parse(path.read_text()) for name, path in MODULES.items()}
    assert any("UNDECODABLE" in caught(tree) for tree in trees.values())
    assert [name for name, tree in trees.items() if any(word in DECODING for word in caught(tree))] == []
