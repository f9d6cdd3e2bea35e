//! The ways of bringing an instance back to its start.

/// How the instances of an FMU are brought back to their start between simulations: the first of these ways that was
/// seen to be right. Right means that runs have the same bits as on a new instance, also after a run with other values;
/// which way is faster is never asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Reuse {
    /// By restoring the state saved when the instance was new (model exchange, FMUs that can save states): it was seen to restore
    /// everything, bit for bit. All values are set again afterwards, and read back.
    Restore,
    /// By the FMU's reset function: it was seen to restore everything, bit for bit.
    Reset,
    /// By a new instance for every simulation: nothing else is offered, or it fails, or it leaves traces.
    Reinstantiate,
    /// By a newly loaded copy of the library, with resources of its own, for every simulation: the model keeps a state outside of its
    /// instances.
    Reload,
}
