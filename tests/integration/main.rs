//! The integration tests: one binary, whose index this is.

mod fmi_host; // a small master, the only place here with unsafe code
mod fmi_lifecycle; // instantiate, the order of calls, reset, independence
mod fmi_log; // categories, logger, environment
mod fmi_step; // communication points, the step grid, discard, status functions
mod fmi_values; // reading and writing variables
