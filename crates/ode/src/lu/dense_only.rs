//! Replacement for the sparse decomposition if the feature `sparse` is off. Its type has no values.

use crate::sparsity::JacobianPattern;
use std::convert::Infallible;
use std::marker::PhantomData;

/// A type without values.
#[derive(Debug)]
pub(crate) struct SparseLu<T> {
    never: Infallible,
    scalar: PhantomData<T>,
}

impl<T> SparseLu<T> {
    /// Returns `None`.
    pub(crate) fn new(_: &JacobianPattern) -> Option<Self> {
        None
    }

    pub(crate) fn pattern(&self) -> &JacobianPattern {
        match self.never {}
    }

    pub(crate) fn decompose(&mut self, _: impl FnMut(usize, bool) -> T) -> bool {
        match self.never {}
    }

    pub(crate) fn solve(&self, _: &mut [T]) {
        match self.never {}
    }
}
