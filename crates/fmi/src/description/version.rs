//! Version of the standard that a file follows, and its consequences for the description and the files of an
//! FMU. For the functions of the library, see `sys`.

use crate::platform::FolderNames;
use std::fmt;

/// Version of the FMI standard that a file follows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FmiVersion {
    /// 1, 2 or 3.
    pub major: u32,
    /// Currently always 0.
    pub minor: u32,
    /// Version string as in the file, for example "2.0" or "3.0.1".
    pub text: String,
}

impl fmt::Display for FmiVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FmiVersion {
    /// True for a draft version, for example "3.0-beta.4", "3.0-rc.1" or "2.0_RC1".
    pub(crate) fn is_draft(&self) -> bool {
        let text = self.text.to_ascii_lowercase();
        ["alpha", "beta", "rc", "draft", "dev"].iter().any(|word| text.contains(word))
    }

    /// True if the standard has a table of allowed combinations of causality, variability, initial and start
    /// value (FMI 2.0.x, section 2.2.7). Descriptions are checked against this table.
    pub(super) fn has_table_of_combinations(&self) -> bool {
        self.major == 2
    }

    /// True if the model structure lists the outputs.
    pub(super) fn lists_outputs(&self) -> bool {
        self.major >= 2
    }

    /// Returns the naming scheme of the folders of binaries.
    pub fn folder_names(&self) -> FolderNames {
        if self.major < 3 { FolderNames::SystemAndBits } else { FolderNames::ProcessorAndSystem }
    }

    /// Returns the name of the macro that stops the standard's headers from prefixing function names with the
    /// model identifier.
    pub(crate) fn plain_names_macro(&self) -> String {
        format!("FMI{}_OVERRIDE_FUNCTION_PREFIX", self.major)
    }
}
