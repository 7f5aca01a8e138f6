"""Errors: one root, few kinds. A message says what was expected, what was got, and where."""

from __future__ import annotations


class ServotapError(Exception):
    """Something the user can mend: wrong use, or an input that cannot be read. `exit_status`: of a command that it ends."""

    exit_status = 2


class UsageError(ServotapError):
    """The command line or an argument is wrong."""


class UnreadableError(ServotapError):
    """A file or a stream cannot be read or understood."""


class PluginError(ServotapError):
    """What another package adds has failed, and nothing goes on without it."""
