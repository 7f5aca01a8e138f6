"""Emulated drives: they answer as the manuals say, with physics, quirks and faults, in real or in virtual time."""
