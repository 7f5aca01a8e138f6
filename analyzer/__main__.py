"""`servotap`, and `python -m analyzer`.

`_signal` is built in: `signal` imports others first, in which Ctrl-C would show its traceback.
"""

import _signal as signal  # type: ignore[import-not-found]
import gc
import os
import sys

# For each core, NumPy would start a thread that waits in a loop for matrices to multiply. Nothing here has any.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# pyarrow has its memory from where NumPy has it, so that each takes what the other gave back.
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")


def main() -> int:
    """Run the command line; until it has begun, Ctrl-C ends the process without a traceback of its imports."""
    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Modules that are loaded leave next to nothing to collect, and each search would go through all that is there by then.
    gc.disable()
    from analyzer.cli import main as command
    from analyzer.system import own_process

    own_process.take()
    signal.signal(signal.SIGINT, handler)
    try:
        return command()
    finally:
        # The process ends and all its memory with it: a last search for reference cycles would be wasted.
        gc.freeze()


if __name__ == "__main__":
    sys.exit(main())
