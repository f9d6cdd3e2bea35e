//! Replacement of the sandbox on systems and in builds that do not support it.

use crate::error::FmiError;

/// Returns the error that explains why there is no sandbox.
///
/// # Errors
/// Always returns [`FmiError::NoSandbox`].
pub fn check_sandbox() -> Result<(), FmiError> {
    let has_system = cfg!(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")));
    let reason = match has_system {
        true => "this build does not include the sandbox (feature `sandbox`)",
        false => "requires Linux on x86-64 or 64-bit ARM",
    };
    Err(FmiError::NoSandbox { reason: reason.to_owned() })
}

/// Returns the error of [`check_sandbox`].
pub(in crate::worker) fn confine_self(_: &std::path::Path) -> std::io::Result<()> {
    check_sandbox().map_err(std::io::Error::other)
}
