"""Calibration of the machine's parameters from a record: `fivebar-twin calibrate`. docs/calibration.md introduces it."""
