"""Lets `python -m fivebar` run the command `fivebar`."""

import sys

from fivebar.commands import main

sys.exit(main())
