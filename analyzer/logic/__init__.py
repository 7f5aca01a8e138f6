"""From the levels of wires to bytes and CAN frames: what a receiver would make of the edges, without any I/O.

`levels` is one channel, `uart` and `can` are the receivers, `search` finds rate and format, `choice` the channels.
"""
