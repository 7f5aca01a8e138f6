"""Captures of raw levels: each format is a module with `score` and `read`.

`waveform` is what such a reader gives. `channels` chooses the lines, and `traffic` reads them.
"""
