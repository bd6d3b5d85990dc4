//! Checks of ranges.

/// A setting outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: expected {expected}, got {got}")]
pub struct SettingsError {
    /// Which one, as in the JSON: `bloom.levels`.
    pub field: &'static str,
    /// Its range.
    pub expected: String,
    /// What it is.
    pub got: String,
}

/// Checks a value against a range, both ends included.
pub(super) fn within<T: PartialOrd + std::fmt::Display + Copy>(
    field: &'static str,
    got: T,
    least: T,
    most: T,
) -> Result<(), SettingsError> {
    // False for NaN.
    if (least..=most).contains(&got) {
        return Ok(());
    }
    Err(SettingsError {
        field,
        expected: format!("{least} to {most}"),
        got: got.to_string(),
    })
}

/// Checks that a value is finite and not below zero.
pub(super) fn not_negative(field: &'static str, got: f32) -> Result<(), SettingsError> {
    if got.is_finite() && got >= 0.0 {
        return Ok(());
    }
    Err(SettingsError {
        field,
        expected: "a finite number, 0 or more".to_owned(),
        got: got.to_string(),
    })
}
