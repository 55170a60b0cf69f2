"""The live twin of a five-bar: messages, estimator, records, replay, watch and dashboard around the FMU. See docs/pipeline.md."""
