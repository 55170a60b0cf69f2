//! Copies of large values without a second value on the stack.

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
