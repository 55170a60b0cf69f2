"""Ensembles of runs: `fivebar ensemble`, and `what-if` from the running twin. See docs/ensembles.md."""
