"""Records for the programs that people look at: time series and a scene, for Foxglove (MCAP) and Rerun."""
