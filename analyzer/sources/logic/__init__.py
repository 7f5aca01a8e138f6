"""Captures of raw levels. `heads` tells them by their first bytes; each format is a module with `read`.

`waveform` is what such a reader gives. `channels` chooses the lines, and `traffic` reads them.
"""
