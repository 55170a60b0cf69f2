//! Stores matrices of nalgebra in saved states, as numbers column by column.

use borsh::io::{self, Read, Write};
use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{ArrayStorage, SMatrix};

use crate::copies::place;

/// Writes the numbers of a matrix.
pub(super) fn write<W: Write, const R: usize, const C: usize>(matrix: &SMatrix<f64, R, C>, writer: &mut W) -> io::Result<()> {
    matrix.data.0.serialize(writer)
}

/// Reads the numbers of a matrix.
pub(super) fn read<S: Read, const R: usize, const C: usize>(reader: &mut S) -> io::Result<SMatrix<f64, R, C>> {
    <[[f64; R]; C]>::deserialize_reader(reader).map(|columns| SMatrix::from_array_storage(ArrayStorage(columns)))
}

/// Reads a large value in a function of its own, so that the stack contains only one at a time.
#[inline(never)]
pub(super) fn read_boxed<R: Read, T: BorshDeserialize>(reader: &mut R) -> io::Result<Box<T>> {
    let place = place();
    Ok(Box::write(place, T::deserialize_reader(reader)?))
}

/// Reads a large value that may be missing, as [`read_boxed`].
pub(super) fn read_optional<R: Read, T: BorshDeserialize>(reader: &mut R) -> io::Result<Option<Box<T>>> {
    bool::deserialize_reader(reader)?.then(|| read_boxed(reader)).transpose()
}
