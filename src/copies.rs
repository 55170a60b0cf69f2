//! Large values are copied and made without a second one on the stack.

use std::hint::black_box;
use std::mem::MaybeUninit;

/// Implements `Clone` such that `clone_from` copies field by field, in place.
macro_rules! clone_by_fields {
    ($Name:ident { $($field:ident),+ $(,)? }) => {
        impl Clone for $Name {
            #[inline(never)]
            fn clone(&self) -> Self {
                Self { $($field: Clone::clone(&self.$field)),+ }
            }

            #[inline(never)]
            fn clone_from(&mut self, other: &Self) {
                let Self { $($field),+ } = self;
                $($field.clone_from(&other.$field);)+
            }
        }
    };
}

pub(crate) use clone_by_fields;

/// Memory on the heap for a large value.
pub(crate) fn place<T>() -> Box<MaybeUninit<T>> {
    let mut place = Box::new_uninit();
    // With the allocator inlined for the browser, LLVM takes the allocator's header of memory that nobody has written for undefined, and its
    // release would trap. Memory that `black_box` has seen may have been written.
    if cfg!(target_family = "wasm") {
        black_box(&mut place);
    }
    place
}
