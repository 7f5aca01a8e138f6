"""What reading JSON and MessagePack raises, where others may have written them.

Bytes from a file, a network or another process are what they are: no JSON, of other fields, no UTF-8, too deep.
"""

from __future__ import annotations

import msgspec

#: Also RecursionError: one datagram of nested maps is enough, even in a field that is passed over.
UNDECODABLE = (msgspec.MsgspecError, ValueError, RecursionError)
