//! The FMI model description: read, checked, completed.
