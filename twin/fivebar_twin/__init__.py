"""The live twin of a five-bar: everything around FiveBar.fmu that turns it into one. docs/pipeline.md introduces it."""
