"""`python -m fivebar`: the command under another name."""

import sys

from fivebar.commands import main

sys.exit(main())
