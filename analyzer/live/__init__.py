"""Live buses: reading them without ever writing to them, and recording what was read.

    port -> reader process -> spool file -> decoding process -> MCAP log

A reader process waits, reads, stamps and stores, and does nothing else (`spool`). All else can be slow, crash or be
restarted without losing a byte.
"""
