"""`python -m fivebar_twin`: the console command under another name."""

import sys

from fivebar_twin.cli import main

sys.exit(main())
