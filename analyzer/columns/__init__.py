"""Columns: many frames at once as NumPy arrays, for captures that are long.

Frames that are in order in every way (`analyzer.records.Lane`) need nothing but their bytes. So a block of them is found,
decoded, paired and written by operations over arrays. All else goes through framer and pipeline one by one, in its place.

    codec    the fields of a layout as columns
    block    CAN frames, bytes of a serial line and the frames in them as columns
    framing  the frames in blocks of bytes
    pairs    which frames of a block are plain exchanges
    text     numbers as JSON text
    rows     messages of a log
    memory   what they are made in
"""
