"""Lines: the host's end of real and emulated buses, for those who send. Only a gate writes to one."""

from __future__ import annotations

from conformance.bus.open import open_line

__all__ = ["open_line"]
