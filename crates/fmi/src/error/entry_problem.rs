//! Reasons to reject an entry of an archive.

/// Reason to reject an entry of an archive.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EntryProblem {
    /// The name is empty, or refers to the root folder of the archive.
    #[error("has an empty name or contains an empty folder name")]
    EmptyName,
    /// The path contains `..` (or `.`, unless the path is the name of an entry).
    #[error("points outside the archive (\"..\" or \".\" in its path)")]
    Traversal,
    /// Starts with `/` or a drive letter.
    #[error("has an absolute path")]
    Absolute,
    /// Contains a backslash, a colon or a control character (NUL included).
    #[error("has the character {0:?} in its name")]
    ForbiddenCharacter(char),
    /// The name or one of its components is longer than file systems allow.
    #[error("has a name of {found} bytes, more than the limit of {limit}")]
    NameTooLong {
        /// Length of the name or component in bytes.
        found: usize,
        /// Maximum length in bytes.
        limit: usize,
    },
    /// The path has more components than allowed.
    #[error("is nested more than {limit} folders deep")]
    TooDeep {
        /// Maximum number of components.
        limit: usize,
    },
    /// A folder with data.
    #[error("is a folder with {0} bytes of data")]
    FolderWithData(u64),
    /// A device name reserved on Windows, or a component ending in a dot or a space.
    #[error("has a name that is not a valid file name on every system")]
    ReservedName,
    /// Neither a file nor a folder: symbolic link, device, pipe or socket.
    #[error("is a {0}, not a file")]
    NotAFile(&'static str),
    /// Encrypted.
    #[error("is encrypted")]
    Encrypted,
    /// A compression method other than stored (0) and deflate (8).
    #[error("is compressed with method {0}; FMUs use 0 (stored) and 8 (deflate)")]
    Compression(u16),
    /// Two entries of the same name with different contents.
    #[error("occurs twice, with different contents")]
    Duplicate,
    /// Two entries whose names differ only in case.
    #[error("differs from \"{0}\" only in upper and lower case")]
    CaseDuplicate(String),
    /// The name is used both for a file and for a folder.
    #[error("makes \"{0}\" both a file and a folder")]
    FileAndFolder(String),
    /// The data overlap the data of another entry.
    #[error("shares bytes {start}..{end} of the archive with \"{other}\"")]
    Overlap {
        /// First shared byte.
        start: u64,
        /// Byte after the last shared byte.
        end: u64,
        /// Name of the other entry.
        other: String,
    },
    /// The local header and the central directory disagree.
    #[error("is described differently in its local header: {0}")]
    HeaderMismatch(String),
    /// The uncompressed size is smaller than the directory declares, or the size of stored data differs.
    #[error("inflates to {found} bytes, but its header declares {declared}")]
    WrongSize {
        /// Size found in bytes.
        found: u64,
        /// Size declared in bytes.
        declared: u64,
    },
    /// Larger than the limit for one file.
    #[error("has {found} bytes, more than the limit of {limit}")]
    TooLarge {
        /// Size declared in bytes.
        found: u64,
        /// Maximum size in bytes.
        limit: u64,
    },
    /// The ratio of uncompressed to compressed size exceeds the limit.
    #[error("would inflate from {compressed} to {size} bytes, more than {limit} times its packed size")]
    Ratio {
        /// Compressed size in bytes.
        compressed: u64,
        /// Declared size in bytes.
        size: u64,
        /// Maximum ratio.
        limit: u64,
    },
    /// The compressed data are damaged (bad stream, wrong checksum, truncated) or inflate to more bytes than
    /// the directory declares.
    #[error("is damaged: {0}")]
    Damaged(String),
}
