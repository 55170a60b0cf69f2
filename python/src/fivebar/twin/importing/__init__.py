"""`fivebar import`: converts recordings of real machines to tables for calibration, validation and twin."""
