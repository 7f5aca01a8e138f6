"""What keeps a real motor and its machine safe while a suite talks to them, and what puts things back.

    suite process   Gate -> RemoteLine  --pipe-->  guard process   Gate -> Line -> port

The guard owns the port. It judges every frame once more at the place where bytes leave, ends motion that has no end after a
time, and when the suite dies, however it dies, it stops the motor, puts back what the journal says, and only then gives
the port back.
"""
