"""Faults of the LK drive: named defects that a good suite must refute. Each changes what can be seen on the bus.

Three tables by what breaks: frames, values, behaviour. A fault takes hold of the drive at the places of `lk_places`;
the drive itself knows none of them. Some show on one model only, that which has the command named in their text.
"""

from __future__ import annotations

from conformance.drives.drive import Fault
from conformance.drives.faults import lk_frames, lk_motion, lk_values

FAULTS: tuple[Fault, ...] = (*lk_frames.FAULTS, *lk_values.FAULTS, *lk_motion.FAULTS)
