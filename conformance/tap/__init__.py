"""A tap: a user's own program and its drive, with everything that passes between them recorded.

    program <-> pseudo-terminal (a link to it)  <->  tap process  <->  adapter <-> drive
                                                        |
                                    thread: 1-NAME-request, 2-NAME-reply (spools, as of any recording)

The adapter gets the program's bytes and no others. So a tap needs no gate; in `conformance` it alone writes without one.

Rules:

1. Bytes are passed on first; a separate thread stores them. A full disk or a dead supervisor delays no byte.
2. Bytes stay unchanged and in order, without repeats. Bytes that the program does not read are kept up to a limit, then counted
   as lost to the program. All of them are recorded. If the adapter takes no bytes, the program waits, as at a real port.
3. The line has the program's settings: `settings`.
4. The program's port stays open while the adapter is gone. Bytes that the program writes meanwhile are counted but not sent.
"""
