"""Before the first claim: is the drive there, is it the one that was named, is it alone where the user says so?

A drive that is not there, at another speed or address, or speaking another dialect is told apart by looking around with
reads alone, and said in one message. One that answers, but wrongly, is let through: the claims say what is wrong with it.
"""

from __future__ import annotations

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from conformance.gate.gate import Gate
from conformance.suite.rig import RigFault
from conformance.suite.sighting import look, neighbours

#: Addresses at which other drives are looked for, where the user says that there are none.
NEIGHBOURS = range(1, 33)


class DriveNotFound(RigFault):
    """The drive that was named does not answer, or another one does."""


def check(gate: Gate, dialect: Dialect, address: int, *, alone: bool) -> str:
    """Make sure that the drive answers, and with `alone` that no other does; return its firmware as far as it told it.

    Raises DriveNotFound with what was heard instead. Sends reads only.
    """
    seen = look(gate, dialect, address)
    if seen.there is None and (seen.elsewhere or not any(h.data for h in seen.report.heard)):
        raise DriveNotFound(seen.text)
    if alone:
        same_bus = [d for d in registry.every() if d.bus == dialect.bus]
        others = neighbours(gate, same_bus, NEIGHBOURS, own=(address,))
        if others:
            names = ", ".join(found.name for found in others)
            raise DriveNotFound(f"--alone was given, but {names} answers too: nothing was sent but reads")
    return seen.there.identity if seen.there is not None else ""
