"""What keeps a real motor and its machine safe while a suite talks to them, and what puts things back.

    suite process   Gate -> RemoteLine  --pipe-->  guard process   Gate -> Line -> port

The guard owns the port. It judges every frame once more at the place where bytes leave. It ends a run without an end after
a time. When the suite dies in any way, it stops the motor, restores the settings in the journal, and then closes the port.
"""
