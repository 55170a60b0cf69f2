"""`fivebar import`: recordings of real machines as tables that calibration, validation and twin read."""
