//! Reasons to refuse an entry of an archive.

/// Reason to refuse an entry of an archive.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EntryProblem {
    /// The name is empty, or names only the folder of the archive.
    #[error("has an empty name or an empty folder name in it")]
    EmptyName,
    /// `..` as a component (`.` in a path that is not the name of an entry).
    #[error("leads out of the archive (\"..\" or \".\" in its path)")]
    Traversal,
    /// Starts with `/` or a drive letter.
    #[error("has an absolute path")]
    Absolute,
    /// Holds a backslash, a colon or a control character (NUL included).
    #[error("has the character {0:?} in its name")]
    ForbiddenCharacter(char),
    /// The name or one of its components is longer than file systems take.
    #[error("has a name of {found} bytes, more than the limit of {limit}")]
    NameTooLong {
        /// Bytes of the name or component.
        found: usize,
        /// Bytes allowed.
        limit: usize,
    },
    /// More folders within folders than allowed.
    #[error("lies more than {limit} folders deep")]
    TooDeep {
        /// Components allowed.
        limit: usize,
    },
    /// A folder that has contents of its own.
    #[error("is a folder with {0} bytes of data")]
    FolderWithData(u64),
    /// A device name reserved on Windows, or a component ending in a dot or a space.
    #[error("has a name that is not a file name on every system")]
    ReservedName,
    /// Neither a file nor a folder: symbolic link, device, pipe or socket.
    #[error("is a {0}, not a file")]
    NotAFile(&'static str),
    /// Encrypted.
    #[error("is encrypted")]
    Encrypted,
    /// A compression method other than stored and deflate.
    #[error("is compressed with method {0}; FMUs use 0 (stored) and 8 (deflate)")]
    Compression(u16),
    /// Two entries of the same name with different contents.
    #[error("occurs twice, with different contents")]
    Duplicate,
    /// Two entries whose names differ in case only.
    #[error("differs from \"{0}\" in upper and lower case only")]
    CaseDuplicate(String),
    /// A file where another entry needs a folder, or the other way round.
    #[error("makes \"{0}\" both a file and a folder")]
    FileAndFolder(String),
    /// The data overlap those of another entry.
    #[error("shares bytes {start}..{end} of the archive with \"{other}\"")]
    Overlap {
        /// First shared byte.
        start: u64,
        /// One behind the last.
        end: u64,
        /// The other entry.
        other: String,
    },
    /// The local header and the central directory disagree.
    #[error("is described differently in its local header: {0}")]
    HeaderMismatch(String),
    /// Inflates to less than the directory says, or is stored with another size.
    #[error("inflates to {found} bytes, its header says {declared}")]
    WrongSize {
        /// Bytes found.
        found: u64,
        /// Bytes declared.
        declared: u64,
    },
    /// Larger than the limit for one file.
    #[error("has {found} bytes, more than the limit of {limit}")]
    TooLarge {
        /// Bytes declared.
        found: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// Inflates more than deflated data of a model do.
    #[error("would inflate from {compressed} to {size} bytes, more than {limit} times")]
    Ratio {
        /// Compressed bytes.
        compressed: u64,
        /// Bytes declared.
        size: u64,
        /// Factor allowed.
        limit: u64,
    },
    /// The compressed data are damaged (bad stream, wrong checksum, truncated) or inflate to more than the
    /// directory says.
    #[error("is damaged: {0}")]
    Damaged(String),
}
