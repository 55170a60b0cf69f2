//! The integration tests as one binary; this file is the index.

// Numerics and physics.
mod accuracy; // orders, round-off floor, reference values in quadruple precision, constraint norms
mod allocation; // a counting allocator: a step allocates nothing
mod automatic; // the method that chooses its scheme: choice, accuracy in time, cost; tangents of accelerations
mod checks; // checks of each step: every fault found by every kind of step, no motion changed
mod closure; // starts: closed and consistent, or refused with one message; singular postures distinguished
mod coaxial; // coaxial motors: branches of the closure, and nearly coaxial machines
mod commands; // commands that act late: shifted motions, grouping of calls, stored, bounded, followed
mod conserving; // the fixed conserving step: energy, constraints, order, every effect, bounded work
mod constraints; // Φ and its derivatives against finite differences along real motions
mod dop853; // the error-controlled explicit method: accuracy, communication points, changing inputs
mod dual_form; // the dual form is the paper's penalty step; the two-leg elimination is the dense solve
mod effects; // each effect: tangents, powers, energy balance, absence
mod effects_known; // effects against results known without our code
mod effects_reference; // scenes with effects against solutions in quadruple precision, through the C functions
mod effects_stiff; // friction through zero, stops and contact hit fast, high gains
mod estimator; // transitions against differences, statistics of samples, faults of encoders, grouping
mod gripper; // a stand-in for a gripper with servo drives whose gain and delay are unknown
mod kinks; // loads with events: contacts, stops, dissipated energy
mod learning; // learned values of a machine: found, left at their priors, bounded, stored
mod payload; // mass that joins the tip during a run, or leaves it
mod physics; // energy, symmetry, reversal, equivalent formulations, bit-equal repetition
mod step_orders; // steps of each kind on problems with known solutions: orders of step and interpolant, stiffness, changes of kind
mod stick; // dry friction that sticks
mod stick_coaxial; // dry friction that sticks, on coaxial motors

// The C functions of FMI.
mod fmi_derivatives; // derivatives of outputs against inputs and states, of inputs and outputs against time
mod fmi_exchange; // model exchange: states, derivatives, events, postures at which states are no coordinates
mod fmi_following; // following a machine: variables, encoder faults, stored states
mod fmi_initial; // dependencies of each output at the start
mod fmi_lifecycle; // instantiation, order of calls, reset, independence
mod fmi_log; // categories, logger, environment
mod fmi_stack; // every function in threads with a small stack
mod fmi_state; // stored states: complete, in any order, as bytes
mod fmi_step; // communication points, the step grid, discard, status functions
mod fmi_values; // reading and writing variables
mod followed_states; // states of followed runs, whatever the samples: restored, and continued with the same bits
mod forged_states; // stored states changed byte by byte: refused, or motions that continue (too many for valgrind)
mod legal_states; // stored states of any motion can be read back and continue with the same bits
mod unknown_commands; // forecasts that do not know the future commands

// Shared code.
mod fmi_host; // a small master; all C calls of tests are here
mod support; // scenes, reference files, slopes
