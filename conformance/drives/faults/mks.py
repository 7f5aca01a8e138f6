"""All faults of the MKS drives: defects by name, each of which a good suite refutes.

    mks_faults_wire       checksums, times, bytes lost and added; these serve any dialect
    mks_faults_hearing    whom a drive hears and answers, packages
    mks_faults_replies    codes, lengths, numbers, statuses
    mks_faults_settings   limits, choices, storing, restart, restore, reading back
    mks_faults_motion     ramps, directions, targets, speeds, stops, modes
    mks_faults_completion interim and completion replies, respond and active
    mks_faults_homing     zero, homing, end limits, locked rotor
    mks_faults_modbus     what only Modbus has

Rules kept here:
- A fault changes what can be seen on the bus in each dialect that it names, and nothing that the manual leaves open.
- Names are unique over all drives.
"""

from __future__ import annotations

from conformance.drives.drive import Fault
from conformance.drives.faults import (
    mks_addressing,
    mks_completion,
    mks_homing,
    mks_modbus,
    mks_motion,
    mks_replies,
    mks_settings,
    mks_wire,
)

FAULTS: tuple[Fault, ...] = (
    *mks_wire.FAULTS,
    *mks_addressing.FAULTS,
    *mks_replies.FAULTS,
    *mks_settings.FAULTS,
    *mks_motion.FAULTS,
    *mks_completion.FAULTS,
    *mks_homing.FAULTS,
    *mks_modbus.FAULTS,
)
