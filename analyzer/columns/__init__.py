"""Columns: many frames at once as NumPy arrays, for captures that are long.

Frames that are in order in every way (`analyzer.records.Lane`) need nothing but their bytes. So a block of them is decoded,
paired and written by operations over arrays. All other frames go through the pipeline one by one, in their place.

    codec    the fields of a layout as columns
    block    CAN frames as columns
    pairs    which frames of a block are plain exchanges
    text     numbers as JSON text
    rows     messages of a log
"""
