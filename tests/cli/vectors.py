"""Every printed frame of every manual, each as a row of a test."""

from __future__ import annotations

import pytest

from analyzer import dialects

VECTORS = [
    pytest.param(dialect, command, vector, id=f"{dialect.name}-{command.name}-{vector.printed}-{number}")
    for dialect in dialects.every()
    for command in dialect.commands
    for number, vector in enumerate(command.vectors)
]
