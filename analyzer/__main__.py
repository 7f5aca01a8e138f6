"""`python -m analyzer` is `servotap`."""

import sys

from analyzer.cli import main

sys.exit(main())
