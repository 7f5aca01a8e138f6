"""Faults of emulated drives: defects by name, each of which a good suite refutes."""
