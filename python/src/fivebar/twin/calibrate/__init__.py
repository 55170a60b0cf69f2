"""Calibration of the machine's parameters from a record: `fivebar calibrate`. docs/calibration.md introduces it."""

import os

# Matrices of 2,000 rows and 20 columns: threads of the linear algebra would only wait for each other. Before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
