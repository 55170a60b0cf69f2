//! A step allocates nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use fivebar::ffi::{fmi2EnterInitializationMode, fmi2ExitInitializationMode, fmi2OK, fmi2Reset};
use fivebar::linear::LinearSolve;
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Method, Simulation};

use crate::fmi_host::{Host, Instantiation, reference};

/// Counts the allocations of each thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

#[allow(unsafe_code)] // the allocator interface is unsafe by definition
// SAFETY: every call is forwarded to the system's allocator; counting only touches a thread-local cell without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's guarantees are forwarded.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's guarantees are forwarded.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of this thread while `work` runs.
pub(crate) fn allocations(work: impl FnOnce()) -> u64 {
    let before = ALLOCATIONS.with(Cell::get);
    work();
    ALLOCATIONS.with(Cell::get) - before
}

#[test]
fn a_step_allocates_nothing() {
    assert!(allocations(|| drop(vec![1, 2, 3])) > 0, "the counter counts");
    // Links next to without inertia take the general solve.
    let plain = Method::LIST.iter().map(|method| (*method, 6.23e-5));
    for (method, inertia) in plain.chain([(Method::I3alp, 1e-9), (Method::I3alpConserving, 1e-9)]) {
        let mut parameters = default_parameters();
        parameters.settings.method = method;
        parameters.geometry.links[1].inertia = inertia;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        assert_eq!(simulation.model().solver.linear_solve() == LinearSolve::Dense, inertia < 1e-6);
        let mut inputs = default_inputs();
        let count = allocations(|| {
            for i in 0..200 {
                inputs.tau[0] = 1e-3 * f64::from(i % 3);
                simulation.advance(&inputs, 1e-3, 2).expect("steps");
            }
        });
        assert_eq!(count, 0, "{method:?}, inertia {inertia}");
    }
}

#[test]
fn a_call_of_do_step_allocates_nothing() {
    let host = Host::ready(&[]);
    let (tau, tip) = ([reference("tau[1]")], [reference("tip.x"), reference("energy.error")]);
    let count = allocations(|| {
        let mut outputs = [0.0; 2];
        for i in 0..200 {
            assert_eq!(host.set_real(&tau, &[1e-3 * f64::from(i % 3)]), fmi2OK);
            assert_eq!(host.do_step(f64::from(i) * 1e-3, 1e-3), fmi2OK);
            assert_eq!(host.get_real(&tip, &mut outputs), fmi2OK);
        }
    });
    assert_eq!(count, 0);
}

/// A step with an estimator allocates nothing, also after the larger state of a learning one has replaced its own.
#[test]
fn a_step_of_a_followed_machine_allocates_nothing() {
    let host = Host::instantiate(Instantiation::default()).unwrap_or_else(|lines| panic!("{lines:?}"));
    let start = |on: &[&str]| {
        assert_eq!(host.setup(None, 0.0, None), fmi2OK);
        for name in on {
            assert_eq!(host.set_boolean(&[reference(name)], &[1]), fmi2OK, "{name}");
        }
        for function in [fmi2EnterInitializationMode, fmi2ExitInitializationMode] {
            assert_eq!(host.call(function), fmi2OK, "{:?}", host.take());
        }
    };
    let step = |i: i32| assert_eq!(host.do_step(f64::from(i) * 1e-3, 1e-3), fmi2OK);
    start(&["estimator.enabled", "estimator.learn.enabled"]);
    let mut learning = host.state();
    assert_eq!(host.call(fmi2Reset), fmi2OK);
    start(&["estimator.enabled"]);
    assert_eq!(allocations(|| (0..100).for_each(step)), 0);
    assert_eq!(host.set_state(learning), fmi2OK);
    assert_eq!(allocations(|| (0..100).for_each(step)), 0);
    assert_eq!(host.free_state(&mut learning), fmi2OK);
}

/// Links with almost no inertia lose no digits: accelerations meet the constraints.
#[test]
fn light_links_are_solved_accurately() {
    for inertia in [1e-5, 1e-8, 1e-10, 1e-12, 1e-14] {
        let mut parameters = default_parameters();
        parameters.start.theta[1] = 120f64.to_radians();
        parameters.start.omega = [1.0, -0.5];
        for link in &mut parameters.geometry.links {
            link.inertia = inertia;
        }
        let simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        let norms = observers::constraint_norms(simulation.model(), &simulation.state());
        let alpha = observers::motion(simulation.model(), &simulation.state()).alpha[0];
        // The limit of vanishing inertia is 19.0695, from the dense solve of an independent program.
        assert!(norms.acceleration < 1e-8, "inertia {inertia}: {norms:?}");
        assert!(inertia > 1e-9 || (alpha - 19.0695).abs() < 1e-3, "inertia {inertia}: {alpha}");
    }
}
