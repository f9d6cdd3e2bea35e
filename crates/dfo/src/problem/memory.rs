//! Check that enough memory is available for a method, before large allocations.

use crate::error::Error;

/// Requests memory for the product of `factors` numbers of 8 bytes from the system, and frees it.
///
/// # Errors
/// Returns an error if the memory is not available.
pub(crate) fn check(what: &'static str, factors: &[usize]) -> Result<(), Error> {
    let bytes = factors.iter().try_fold(8usize, |bytes, factor| bytes.checked_mul(*factor));
    let granted = bytes.is_some_and(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok());
    let wanted = factors.iter().fold(8.0, |bytes, factor| bytes * *factor as f64);
    if granted { Ok(()) } else { Err(Error::Memory { what, bytes: wanted }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn excessive_memory_is_rejected_with_its_size() {
        assert_eq!(check("a simplex", &[1000, 1000]), Ok(()));
        for factors in [&[1 << 20, 1 << 30][..], &[usize::MAX, 3]] {
            let message = check("a simplex", factors).unwrap_err().to_string();
            assert!(message.starts_with("not enough memory for a simplex, which requires "), "{message}");
        }
        assert!(check("x", &[1 << 22, 1 << 30]).unwrap_err().to_string().contains("36028.8 TB"));
    }
}
