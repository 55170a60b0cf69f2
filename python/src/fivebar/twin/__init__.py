"""The live twin of a five-bar: messages, corrector, records, replay, watch and dashboard around the unit. docs/pipeline.md introduces it."""
