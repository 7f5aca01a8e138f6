"""Lines: the host's end of real and emulated buses. Only a gate writes to a line."""

from __future__ import annotations

from conformance.bus.open import at_default_rate, open_line

__all__ = ["at_default_rate", "open_line"]
