"""A tap: a user's own program and its drive, with everything that passes between them recorded.

    program <-> pseudo-terminal (a link to it)  <->  tap process  <->  adapter <-> drive
                                                        |
                                    thread: 1-NAME-request, 2-NAME-reply (spools, as of any recording)

Whatever the program writes goes to the adapter, and nothing else does: no byte of the bus is this program's own. So a tap is
the one thing in `conformance` that writes without passing the gate, and it writes nothing that it was not given.

Rules:

1. Bytes first. They are passed on before anything is made of them; storing them is a thread's work, and neither a full disk
   nor a dead supervisor keeps them waiting.
2. Unchanged, in order, none twice. What the program does not read is kept up to a limit and then counted as lost to the
   program; it is recorded all the same. What the adapter does not take makes the program wait, as a real port would.
3. The line runs as the program sets it up: `settings`.
4. The adapter comes and goes without the program's port going; what the program writes meanwhile is counted and not sent.
"""
