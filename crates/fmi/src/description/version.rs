//! The version of the standard that a file follows, and what follows from it for its description and its
//! files. The functions of a library are another matter: see `sys`.

use crate::platform::FolderNames;
use std::fmt;

/// Version of the FMI standard a file follows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FmiVersion {
    /// 1, 2 or 3.
    pub major: u32,
    /// 0 so far.
    pub minor: u32,
    /// As written in the file: "2.0", "3.0.1".
    pub text: String,
}

impl fmt::Display for FmiVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FmiVersion {
    /// True for a draft of a version: "3.0-beta.4", "3.0-rc.1", "2.0_RC1".
    pub(crate) fn is_draft(&self) -> bool {
        let text = self.text.to_ascii_lowercase();
        ["alpha", "beta", "rc", "draft", "dev"].iter().any(|word| text.contains(word))
    }

    /// True if the standard has a table of the allowed combinations of causality, variability and initial,
    /// and of the start values that go with them, by which a description can be judged (FMI 2.0.x, section
    /// 2.2.7).
    pub(super) fn has_table_of_combinations(&self) -> bool {
        self.major == 2
    }

    /// True if the model structure lists the outputs.
    pub(super) fn lists_outputs(&self) -> bool {
        self.major >= 2
    }

    /// Naming scheme of the folders of binaries.
    pub fn folder_names(&self) -> FolderNames {
        if self.major < 3 { FolderNames::SystemAndBits } else { FolderNames::ProcessorAndSystem }
    }

    /// The macro that keeps the headers of the standard from putting the model identifier before the names of
    /// functions.
    pub(crate) fn plain_names_macro(&self) -> String {
        format!("FMI{}_OVERRIDE_FUNCTION_PREFIX", self.major)
    }
}
