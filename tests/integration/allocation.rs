//! A step allocates nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use fivebar::fmi::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Method, Simulation};

/// Counts the allocations of each thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

#[allow(unsafe_code)] // the allocator interface is unsafe by definition
// SAFETY: every call is passed on to the system's allocator; counting touches a thread-local cell without a destructor only.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
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
    for method in [Method::I3alp, Method::I3alpPrinted, Method::Rk4] {
        let mut parameters = default_parameters();
        parameters.settings.method = method;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        let mut inputs = default_inputs();
        let count = allocations(|| {
            for i in 0..200 {
                inputs.tau[0] = 1e-3 * f64::from(i % 3);
                simulation.advance(&inputs, 1e-3, 2).expect("steps");
            }
        });
        assert_eq!(count, 0, "{method:?}");
    }
}
