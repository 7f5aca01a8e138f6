"""Print the shell code that completes the commands of servotap: options, dialects, commands, fields, endpoints.

Put it where your shell looks at its start, as in the examples; a new shell then completes with the Tab key.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any

SHELLS = ("bash", "zsh", "fish")
EXAMPLES = """\
examples:
  servotap completion bash > ~/.local/share/bash-completion/completions/servotap
  servotap completion fish > ~/.config/fish/completions/servotap.fish
  echo 'eval "$(servotap completion zsh)"' >> ~/.zshrc
"""
Completer = Callable[..., Iterable[str]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("shell", nargs="?", default=os.path.basename(os.environ.get("SHELL", "")), metavar="SHELL",
                        help=f"{', '.join(SHELLS)}; default: yours")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Print the code."""
    from argcomplete.shell_integration import shellcode

    from analyzer.errors import UsageError
    from analyzer.values import quote

    if arguments.shell not in SHELLS:
        raise UsageError(f"got the shell {quote(arguments.shell)}, expected one of {', '.join(SHELLS)}")
    print(shellcode(["servotap"], shell=arguments.shell))
    return 0


def complete(commands: Mapping[str, tuple[str, str]]) -> None:
    """Answer the shell, which has called servotap to complete a line, and end. `commands`: name -> (module, help)."""
    import argcomplete

    from analyzer.errors import UsageError
    from analyzer.system import own_process
    from analyzer.values import quote

    for name in ("COMP_POINT", "COMP_TYPE", "_ARGCOMPLETE"):
        if not (given := os.environ.get(name, "0")).isdecimal():
            raise UsageError(f"{name}: expected a number, as shells set it, got {quote(given)}")
    words = os.environ.get("COMP_LINE", "").split()
    parser = argparse.ArgumentParser(prog="servotap")
    below = parser.add_subparsers(metavar="COMMAND")
    for name, (module, text) in commands.items():
        of_command = below.add_parser(name, help=text)
        # The module of one command is needed at most.
        if name == (words[1] if len(words) > 1 else ""):
            import_module(module).add_arguments(of_command)
            _teach(of_command)
    argcomplete.autocomplete(parser, exit_method=own_process.end)


def _teach(parser: argparse.ArgumentParser) -> None:
    """Give the arguments of a command what completes them, by what their help calls them."""
    for action in parser._actions:
        known = _COMPLETERS.get(str(action.metavar))
        if known is not None:
            # argcomplete looks for it there.
            action.completer = known  # type: ignore[attr-defined]


# --- what stands for an argument --------------------------------------------------------------------------------------


def _listed(names: Callable[[], Iterable[str]]) -> Completer:
    """Return what completes a list with commas: the last of it."""

    def completer(prefix: str, **_: Any) -> list[str]:
        before, comma, _last = prefix.rpartition(",")
        return [f"{before}{comma}{name}" for name in names()]

    return completer


def _dialects() -> list[str]:
    from analyzer import dialects

    return dialects.readable()


def _risks() -> list[str]:
    from analyzer.catalogue import Risk

    return [risk.value for risk in Risk]


def _models() -> list[str]:
    from analyzer import dialects

    return list(dict.fromkeys(model for dialect in dialects.every() for model in dialect.models))


def _drives() -> list[str]:
    """Return what a drive may be: a name of a profile, or a dialect and address 1, which drives have at first."""
    from analyzer import dialects
    from analyzer.live import profile

    return [*profile.names(), *(f"{name}@1" for name in dialects.names())]


def _commands(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Complete a command: of the dialect that is named, else of all."""
    from analyzer import dialects

    name = getattr(parsed_args, "dialect", None)
    some = [dialects.get(name)] if name in dialects.names() else dialects.every()
    return list(dict.fromkeys(command.name for dialect in some for command in dialect.commands))


def _request(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """Complete the next word: the drive, the command, a field or its choice."""
    from analyzer import dialects
    from analyzer.errors import ServotapError
    from analyzer.live import profile

    if not getattr(parsed_args, "target", None) or not hasattr(parsed_args, "command"):
        return _drives()
    try:
        named = profile.drive(parsed_args.target)
        dialect = dialects.get(parsed_args.target.partition("@")[0]) if named is None else named.dialect
    except ServotapError:
        return []
    commands = {command.name: command for command in dialect.commands}
    if parsed_args.command not in commands:
        return list(commands)
    fields = {n: field for form in commands[parsed_args.command].request_forms for n, field in form.layout.named.items()}
    given, equals, _value = prefix.partition("=")
    if equals and given in fields:
        return [f"{given}={choice}" for choice in fields[given].choice_names.values()]
    return [f"{n}=" for n in fields]


def _endpoints(prefix: str, **_: Any) -> list[str]:
    """Complete an endpoint: names of profiles, the serial ports and CAN interfaces of this machine, then the kinds."""
    from analyzer.live import profile
    from analyzer.live.adapters import can_interfaces, serial_adapters

    here = [each.endpoint for each in serial_adapters()] + [each.endpoint for each in can_interfaces()]
    named, equals, _rest = prefix.partition("=")
    before = f"{named}=" if equals and ":" not in named else ""
    return [before + each for each in (*profile.names(), *here, "serial:", "tcp:", "can:socketcan:", "can:slcan:")]


_COMPLETERS: dict[str, Completer] = {
    "D": _listed(_dialects),
    "DIALECTS": _listed(_dialects),
    "M": lambda **_: _models(),
    "RISKS": _listed(_risks),
    "DRIVE": _request,
    "DIALECT@ADDRESS": _request,
    "COMMAND": _request,
    "FIELD=VALUE": _request,
    "NAME|CODE": _commands,
    "ENDPOINT": _endpoints,
    "[NAME=]ENDPOINT": _endpoints,
    "SHELL": lambda **_: SHELLS,
}
