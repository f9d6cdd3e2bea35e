//! The command line as a program: output, written files and exit codes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod files;
mod fit;
mod help;
mod init;
mod interrupt;
mod jobs;
mod json_schema;
mod models;
mod optimize;
mod schema;
mod sensitivity;
mod support;
