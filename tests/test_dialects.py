"""Dialects by name, and commands by what people type."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from analyzer import dialects, plugins
from analyzer.errors import UsageError


@pytest.fixture
def _fresh():
    def forget():
        dialects._added.cache_clear()
        dialects.get.cache_clear()

    forget()
    yield
    forget()


def test_every_dialect_is_found_by_its_name_and_once():
    for name in dialects.names():
        assert dialects.get(name).name == name
        assert dialects.get(name) is dialects.get(name)
    assert [d.name for d in dialects.every()] == dialects.names()
    assert list(dialects.by_name()) == dialects.names()


def test_an_unknown_name_says_the_nearest():
    with pytest.raises(UsageError, match="did you mean mks-rs485"):
        dialects.get("mks-rs458")


@pytest.mark.usefixtures("_fresh")
def test_a_package_adds_a_dialect_by_an_entry_point(monkeypatch):
    added = replace(dialects.get("mks-can"), name="extra")
    point = SimpleNamespace(name="x", value="extra:D", load=lambda: added)
    monkeypatch.setattr(plugins, "points", lambda group: [point] if group == dialects.GROUP else [])
    dialects._added.cache_clear()
    assert dialects.names()[-1] == "extra"
    assert dialects.get("extra").commands is added.commands
    assert isinstance(dialects.get("extra").link, type(added.link))


def _ends():
    raise SystemExit(1)


@pytest.mark.usefixtures("_fresh")
@pytest.mark.parametrize(
    ("load", "why"),
    [
        (lambda: "no dialect", "x of servotap.dialects failed and is left out: UsageError: expected a Dialect, got str"),
        (lambda: 1 / 0, "x (bad:\\x1b) of servotap.dialects failed and is left out: ZeroDivisionError: division by zero"),
        (
            lambda: replace(dialects.get("mks-can")),
            "x of servotap.dialects failed and is left out: UsageError: the name mks-can is taken: expected another one",
        ),
        (
            lambda: replace(dialects.get("mks-can"), name="new", link=None),
            "x of servotap.dialects failed and is left out: UsageError: new: expected a Link, got NoneType",
        ),
        (_ends, "x (bad:\\x1b) of servotap.dialects failed and is left out: SystemExit: 1"),
    ],
)
def test_a_dialect_that_cannot_be_had_is_named_and_left_out(load, why, monkeypatch, capsys):
    point = SimpleNamespace(name="x", value="bad:\x1b", load=load)
    monkeypatch.setattr(plugins, "points", lambda group: [point] if group == dialects.GROUP else [])
    dialects._added.cache_clear()
    assert "mks-can" in dialects.names()
    assert len(dialects.names()) == len(dialects._OWN)
    assert capsys.readouterr().err == f"servotap: {why}\n"


def test_a_model_changes_the_dialects_that_know_it_alone():
    both = [dialects.get("mks-rs485"), dialects.get("lk-rs485")]
    changed = dialects.for_model(both, "42d")
    assert changed[0] is not both[0]
    assert changed[1] is both[1]
    assert dialects.for_model(both, None) == both
    with pytest.raises(UsageError, match="no model 'XYZ'"):
        dialects.for_model(both, "XYZ")


@pytest.mark.parametrize("name", dialects.names())
def test_every_command_is_found_by_its_name_and_by_its_code(name):
    dialect = dialects.get(name)
    for command in dialect.commands:
        assert dialects.find_command(dialect, command.name) is command
        assert dialects.find_command(dialect, command.name.replace("_", "-").upper()) is command
        code = dialects.code_text(command.code, command.function)
        assert command in [c for _, c in dialects.find_commands([dialect], code)]
        if command.function is not None:
            assert command in [c for _, c in dialects.find_commands([dialect], f"{command.function:02X}:{command.code:04X}")]


def test_a_code_of_several_commands_names_them():
    with pytest.raises(UsageError, match="stop_speed or run_speed"):
        dialects.find_command(dialects.get("mks-rs485"), "F6")
    with pytest.raises(UsageError, match="did you mean run_speed"):
        dialects.find_command(dialects.get("mks-rs485"), "run_sped")
    with pytest.raises(UsageError, match="no dialect has a command"):
        dialects.find_commands(dialects.every(), "fly")
