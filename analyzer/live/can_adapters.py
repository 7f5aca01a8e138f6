"""Asks python-can's interfaces what is connected, in a process of its own: `python -m analyzer.live.can_adapters`.

The interfaces load the vendors' libraries, which may hang, print or crash; none of that may reach the command that asks.
It prints one JSON list on standard output. SocketCAN is left out, sysfs tells more of it; so are buses of software alone.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

from analyzer.system import own_process
from analyzer.system.own_process import without

#: Seconds for all interfaces together.
TIMEOUT_S = 4.0
#: Interfaces that need no asking: SocketCAN, buses without a wire, and serial ports, which are listed as such.
_LEFT_OUT = frozenset({"socketcan", "socketcand", "virtual", "udp_multicast", "serial", "slcan", "robotell", "cantact"})


def detect() -> tuple[list[dict[str, Any]], str]:
    """Return python-can's configurations, and why there may be more of them ("" if that is all)."""
    words = [sys.executable, "-m", __name__]
    try:
        # Twice the time: the libraries have to be loaded, too.
        done = subprocess.run(words, capture_output=True, text=True, timeout=2 * TIMEOUT_S + 4, check=False)
        listed = json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        return [], f"python-can's interfaces did not answer within {2 * TIMEOUT_S + 4:.0f} s"
    except (OSError, ValueError):
        return [], "python-can's interfaces could not be asked"
    return [entry for entry in listed if isinstance(entry, dict)], ""


def main() -> None:
    """Print the configurations as JSON."""
    import inspect
    import logging
    import os

    logging.disable(logging.CRITICAL)
    # What a vendor's library prints goes elsewhere than our answer.
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    with without("asammdf"):
        import can

    names = [name for name in sorted(can.VALID_INTERFACES) if name not in _LEFT_OUT]
    # Releases before 4.6 have no time-out of their own; the one around this process holds for all.
    timed = "timeout" in inspect.signature(can.detect_available_configs).parameters
    found = can.detect_available_configs(names, **({"timeout": TIMEOUT_S} if timed else {}))
    answer.write(json.dumps([dict(entry) for entry in found], default=str))
    answer.flush()
    # A library that hangs in a thread would keep this process.
    os._exit(0)


if __name__ == "__main__":
    own_process.is_own = True
    main()
