//! The integration tests: one binary, whose index this is.

// The numeric rooms.
mod accuracy; // orders, round-off floor, reference values in quadruple precision, constraint norms
mod allocation; // a counting allocator: a step allocates nothing
mod automatic; // the method that chooses its scheme: choice, time, price; tangents of accelerations
mod checks; // checks of each step: every fault found by every kind of step, no motion changed
mod closure; // starts: closed and consistent, or refused with one sentence; singular postures told apart
mod coaxial; // coaxial motors: branches of the closure, and machines that are close to having them
mod conserving; // the strictly fixed step that conserves: energy, constraints, order, every effect, bounded work
mod constraints; // Φ and its derivatives against finite differences along real motions
mod dop853; // the error-controlled explicit method: accuracy, communication points, changing inputs
mod dual_form; // the dual form is the paper's penalty step; the two-leg elimination is the dense solve
mod effects; // each effect: tangents, powers, energy balance, absence
mod effects_known; // effects against results known without our code
mod effects_reference; // scenes with effects against solutions in quadruple precision, through the C functions
mod effects_stiff; // friction through zero, stops and contact hit fast, high gains
mod estimator; // transitions against differences, statistics of samples, faults of encoders, grouping
mod kinks; // loads with events: contacts, stops, dissipated energy
mod learning; // what is learned of a machine: found, left at its prior, bounded, stored
mod payload; // mass that joins the tip during a run, or leaves it
mod physics; // energy, symmetry, reversal, equivalent formulations, bit-equal repetition
mod step_orders; // steps of each kind on problems with known solutions: orders of step and interpolant, stiffness, changes of kind
mod stick; // dry friction that holds
mod stick_coaxial; // dry friction that sticks, on coaxial motors

// The FMI rooms, through the C functions.
mod fmi_derivatives; // derivatives of outputs against inputs and states, of inputs and outputs against time
mod fmi_exchange; // model exchange: states, derivatives, events, where they are no coordinates
mod fmi_following; // a machine that is followed: variables, faults of encoders, stored states
mod fmi_initial; // dependencies of each output at the start
mod fmi_lifecycle; // instantiate, the order of calls, reset, independence
mod fmi_log; // categories, logger, environment
mod fmi_stack; // every function in threads with little stack
mod fmi_state; // stored states: complete, in any order, as bytes
mod fmi_step; // communication points, the step grid, discard, status functions
mod fmi_values; // reading and writing variables
mod forged_states; // stored states changed byte by byte: refused, or motions that go on (more than valgrind has time for)
mod legal_states; // stored states of any motion are read back, and go on to the same bits

// Code that tests of the C functions share.
mod fmi_host; // a small master: C calls are made here and nowhere else
mod support; // scenes, reference files, slopes
