"""Calibration of the machine's parameters from a record: `fivebar calibrate`. See docs/calibration.md."""

import os

# The matrices are small (2,000 rows, 20 columns), so that threads of the linear algebra only cost time. OpenBLAS reads this when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
