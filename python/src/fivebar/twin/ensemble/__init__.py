"""Ensembles of runs on Dask: `fivebar ensemble`, and `what-if` from the running twin. docs/ensembles.md introduces them."""
