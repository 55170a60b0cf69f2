"""`python -m fivebar.twin`: the console command under another name."""

import sys

from fivebar.twin.cli import main

sys.exit(main())
