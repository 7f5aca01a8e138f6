"""Emulated drives on the real clock: a bus behind a pseudo-terminal, a TCP port or a python-can interface."""
