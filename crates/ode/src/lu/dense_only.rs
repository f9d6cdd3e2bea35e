//! Stands in for the sparse decomposition where the feature `sparse` is off: there is none, and no value of
//! its type.

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
    /// `None`.
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
