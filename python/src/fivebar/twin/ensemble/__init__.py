"""Ensembles of runs: `fivebar ensemble`, and `what-if` from the running twin. docs/ensembles.md introduces them."""
