//! The integration tests: one binary, whose index this is.
