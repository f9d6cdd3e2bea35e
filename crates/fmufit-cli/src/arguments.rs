//! The arguments of the command line, and what `--help` teaches about them.

use crate::error::Error;
use calibration::SimulationSettings;
use clap::{Args, Parser, Subcommand, ValueEnum};
use fmi::Fmu;
use std::path::{Path, PathBuf};

/// Fit the parameters of Functional Mock-up Units (FMUs) to measurements.
#[derive(Debug, Parser)]
#[command(
    name = "fmufit",
    version,
    arg_required_else_help = true,
    after_help = "A first fit:\n  \
        fmufit info plant.fmu                      what the model has\n  \
        fmufit init plant.fmu run.csv problem.toml writes a problem file with comments; edit it\n  \
        fmufit check problem.toml                  looks for mistakes\n  \
        fmufit fit problem.toml --save plant.fit   fits\n  \
        fmufit report plant.fit plant.html         one page with figures\n\n\
        Exit codes:\n  \
        0    all went well\n  \
        1    the work was done, and did not succeed\n  \
        2    arguments, files or values that cannot be used\n  \
        3    the fit ran, and its result is not to be used: the findings that are errors say why\n  \
        130  Ctrl-C, SIGTERM or the button of --watch; of a fit the best point is printed and saved"
)]
pub(crate) struct CommandLine {
    /// Print results and errors only
    #[arg(short, long, global = true)]
    pub(crate) quiet: bool,
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Show what a model has: interfaces, default experiment, variables
    #[command(
        after_help = "Example:\n  fmufit info plant.fmu --causality parameter\n\nRuns no code of the model."
    )]
    Info(Info),
    /// Look for departures from the standard, and simulate a model in a process of its own
    #[command(
        after_help = "Example:\n  fmufit validate plant.fmu --timeout 20\n\nExits with 1 if the model cannot be simulated."
    )]
    Validate(Validate),
    /// Simulate a model; the result is a CSV table
    #[command(
        after_help = "Examples:\n  fmufit simulate plant.fmu --final-time 40 --set friction=0.01 --output run.csv\n  \
            fmufit simulate plant.fmu --input recorded.csv --outputs T --outputs 'tank.*' --plot run.svg"
    )]
    Simulate(Simulate),
    /// Write a problem file with comments from a model and a recording
    #[command(
        after_help = "Example:\n  fmufit init plant.fmu run.csv problem.toml\n\nOutputs and inputs are matched with columns by their \
            names. Parameters that move no output\nat the start are written as comments."
    )]
    Init(Init),
    /// Look for mistakes in a problem before a fit
    #[command(
        after_help = "Example:\n  fmufit check problem.toml --preflight\n\nExits with 1 if an error was found."
    )]
    Check(Check),
    /// Fit parameters to recordings
    #[command(after_help = "Examples:\n  fmufit fit problem.toml --save plant.fit --report plant.html\n  \
            fmufit fit furuta.fmu furuta.csv --output armJoint.phi=phi --parameter armFriction=0.012:0:0.022\n  \
            fmufit fit problem.toml --option method=de --option max_time=60 --setting solver=radau5\n\n\
            Ctrl-C ends the fit with the best point, which is printed and saved (exit code 130).\n\
            Exits with 1 if the search did not converge, with 3 if it did and the result is not to be used: the simulation is\n\
            worse than a constant.")]
    Fit(Fit),
    /// Continue a fit from its checkpoint
    #[command(
        after_help = "Example:\n  fmufit fit problem.toml --checkpoint plant.ckpt     (Ctrl-C, a reboot)\n  \
            fmufit resume problem.toml --checkpoint plant.ckpt\n\nThe result has the same bits as that of a fit that was not interrupted."
    )]
    Resume(Fit),
    /// Write the report of a saved fit: a page, or a file for other programs
    #[command(
        after_help = "Examples:\n  fmufit report plant.fit plant.html    a page with tables and figures\n  \
            fmufit report plant.fit plant.csv     parameters as a table\n  \
            fmufit report plant.fit plant.ssv     parameters for SSP tools\n  fmufit report plant.fit plant.json    all numbers"
    )]
    Report(Report),
    /// Compile a source-code FMU for this platform
    #[command(
        after_help = "Example:\n  fmufit build plant/ plant.fmu\n\nRuns the C compiler of this machine on the sources of the model."
    )]
    Build(Build),
    /// Write the JSON schema of problem files, or of a result, to the standard output
    #[command(
        after_help = "Example:\n  fmufit schema > problem.schema.json\n\nEditors that know TOML check a problem file against it and complete \
            its fields; the first line\nof what init writes names this file."
    )]
    Schema(SchemaOf),
    /// Write the completions of a shell to the standard output
    #[command(
        after_help = "Example:\n  fmufit completions bash > ~/.local/share/bash-completion/completions/fmufit"
    )]
    Completions(Completions),
    /// Serve as the process in which models of another program run; that program starts it
    #[command(hide = true)]
    Worker,
}

impl Command {
    /// True if the result is to be JSON: an error is, too.
    pub(crate) fn is_json(&self) -> bool {
        match self {
            Self::Info(Info { json, .. })
            | Self::Validate(Validate { json, .. })
            | Self::Check(Check { json, .. })
            | Self::Fit(Fit { json, .. })
            | Self::Resume(Fit { json, .. }) => *json,
            _ => false,
        }
    }
}

/// Limits with which a model is opened.
#[derive(Debug, Args)]
pub(crate) struct Limits {
    /// Largest size of modelDescription.xml, in bytes; default: 64 MiB
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) max_description_bytes: Option<u64>,
}

impl Limits {
    /// Opens a model.
    pub(crate) fn open(&self, model: &Path) -> Result<Fmu, Error> {
        let settings = SimulationSettings {
            max_description_bytes: self.max_description_bytes,
            ..SimulationSettings::default()
        };
        Fmu::open_with(model, &settings.open_options()).map_err(Error::input)
    }
}

#[derive(Debug, Args)]
pub(crate) struct Info {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// All variables, internal ones too
    #[arg(long)]
    pub(crate) all: bool,
    /// Only variables of this causality: parameter, input, output, local and so on
    #[arg(long, value_name = "WORD")]
    pub(crate) causality: Option<String>,
    /// A JSON document with all variables
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Validate {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// Limit of the simulation, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    pub(crate) timeout: f64,
    /// Confine the model: it writes into a folder of its own only, and opens no connections (Linux)
    #[arg(long)]
    pub(crate) sandbox: bool,
    /// A JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Simulate {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// Value of a parameter, or start value of a variable, or all those of an SSP parameter file; may be
    /// given several times
    #[arg(long = "set", value_name = "NAME=VALUE | @FILE.ssv")]
    pub(crate) values: Vec<String>,
    /// Value of a continuous state at the start, also if the initialization computes another one (model
    /// exchange); may be given several times
    #[arg(long = "initial-state", value_name = "NAME=NUMBER")]
    pub(crate) initial_states: Vec<String>,
    /// A CSV file with a column `time`, and one for each input or tunable parameter that is called as its
    /// column
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) input: Option<PathBuf>,
    /// Name of its column of times, where it is not `time`
    #[arg(long, value_name = "COLUMN", requires = "input")]
    pub(crate) time: Option<String>,
    /// The unit of a variable of which the model states none; may be given several times
    #[arg(long, value_name = "VARIABLE=UNIT")]
    pub(crate) unit: Vec<String>,
    /// File of the table; default, and -: the standard output
    #[arg(short, long, value_name = "FILE.csv")]
    pub(crate) output: Option<PathBuf>,
    /// Variables to record: names, patterns with * and ?, `all`; default: outputs and states
    #[arg(long, value_name = "NAME")]
    pub(crate) outputs: Vec<String>,
    /// Where the simulation starts, in s; default: that of the model, else 0
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) start_time: Option<f64>,
    /// Where it ends, in s; default: that of the model
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) final_time: Option<f64>,
    /// Distance of the rows, in s; default: 500 intervals
    #[arg(long, value_name = "SECONDS")]
    pub(crate) interval: Option<f64>,
    /// Integration method
    #[arg(long, value_name = "NAME")]
    pub(crate) solver: Option<String>,
    /// Interface: ME (model exchange) or CS (co-simulation)
    #[arg(long, value_name = "NAME")]
    pub(crate) kind: Option<String>,
    /// Relative tolerance; default: that of the model, else 1e-6
    #[arg(long, value_name = "NUMBER")]
    pub(crate) tolerance: Option<f64>,
    /// Step of a fixed-step method, communication step of a co-simulation, in s
    #[arg(long, value_name = "SECONDS")]
    pub(crate) step_size: Option<f64>,
    /// Limit of wall-clock time, in seconds
    #[arg(long, value_name = "SECONDS")]
    pub(crate) timeout: Option<f64>,
    /// Draw the result into a file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Run the model in this process
    #[arg(long, conflicts_with = "sandbox")]
    pub(crate) in_process: bool,
    /// Confine the model: it writes into a folder of its own only, and opens no connections (Linux)
    #[arg(long)]
    pub(crate) sandbox: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Init {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// A recording: a CSV file with a column of times
    pub(crate) data: PathBuf,
    /// The file to write
    #[arg(default_value = "problem.toml")]
    pub(crate) problem: PathBuf,
    /// A variable and the column that measured it; may be given several times
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) output: Vec<String>,
    /// An input and the column that drives it; may be given several times
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) input: Vec<String>,
    /// A parameter to fit; may be given several times. Default: all that move an output
    #[arg(long, value_name = "NAME")]
    pub(crate) parameter: Vec<String>,
    /// Name of the column of times, where it is not `time`
    #[arg(long, value_name = "COLUMN")]
    pub(crate) time: Option<String>,
    /// Run no code of the model: all parameters are proposed
    #[arg(long)]
    pub(crate) no_run: bool,
    /// Confine the model, here and in fits of the problem: it writes into a folder of its own only, and opens
    /// no connections (Linux)
    #[arg(long)]
    pub(crate) sandbox: bool,
    /// Replace a file that is there
    #[arg(long)]
    pub(crate) force: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(flatten)]
    pub(crate) problem: Problem,
    /// Simulate nothing
    #[arg(long)]
    pub(crate) no_run: bool,
    /// Also move each parameter: which ones have an effect, which are confounded, how long a fit will take
    #[arg(long, conflicts_with = "no_run")]
    pub(crate) preflight: bool,
    /// A JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

/// A problem: a file, or a model and a recording with names.
#[derive(Debug, Args)]
pub(crate) struct Problem {
    /// A problem file (see `fmufit init`; - is the standard input), or a model
    #[arg(value_name = "PROBLEM.toml | MODEL.fmu")]
    pub(crate) problem: PathBuf,
    /// With a model: the recording, a CSV file
    pub(crate) data: Option<PathBuf>,
    /// With a model: a variable and the column that measured it; may be given several times
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) output: Vec<String>,
    /// With a model: an input, and the column or the number that drives it; may be given several times.
    /// Default: the columns that are called as inputs
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) input: Vec<String>,
    /// With a model: a parameter, its start and its bounds; may be given several times
    #[arg(long, value_name = "NAME=START:LOWER:UPPER")]
    pub(crate) parameter: Vec<String>,
    /// With a model: name of the column of times, where it is not `time`
    #[arg(long, value_name = "COLUMN")]
    pub(crate) time: Option<String>,
    /// With a model: time of the recording at which the model has its start values, in s, as in
    /// [[experiments]]; default: that of the model, mostly 0
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) start_time: Option<f64>,
    /// The unit of a variable of which the model states none; may be given several times
    #[arg(long, value_name = "VARIABLE=UNIT")]
    pub(crate) unit: Vec<String>,
    /// A setting of the simulations, as in [settings]; may be given several times
    #[arg(short = 'S', long, value_name = "NAME=VALUE")]
    pub(crate) setting: Vec<String>,
    /// Confine the model: it writes into a folder of its own only, and opens no connections (Linux); the same
    /// as --setting sandbox=true
    #[arg(long)]
    pub(crate) sandbox: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Fit {
    #[command(flatten)]
    pub(crate) problem: Problem,
    /// An option of the fit, as in [fit]; may be given several times
    #[arg(short = 'O', long, value_name = "NAME=VALUE")]
    pub(crate) option: Vec<String>,
    /// File in which the state of the fit is kept, for `fmufit resume`
    #[arg(long, value_name = "FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// Save the fit, for `fmufit report` and `pydfo.load_fit`
    #[arg(short, long, value_name = "FILE.fit")]
    pub(crate) save: Option<PathBuf>,
    /// Write a page with tables and figures (.html), or what `fmufit report` writes
    #[arg(short, long, value_name = "FILE.html")]
    pub(crate) report: Option<PathBuf>,
    /// Show the fit while it runs on a page of this machine, whose address is printed, with a button that
    /// ends it; afterwards its report, on a terminal until Ctrl-C
    #[arg(long)]
    pub(crate) watch: bool,
    /// The result as a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Report {
    /// A fit that was saved
    pub(crate) fit: PathBuf,
    /// The file to write; its suffix says what: .html, .csv, .json, .ssv
    pub(crate) output: PathBuf,
    /// The model, where it is not at its place any more
    #[arg(long, value_name = "MODEL.fmu")]
    pub(crate) model: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct Build {
    /// A folder with modelDescription.xml and sources/, or an .fmu file
    pub(crate) model: PathBuf,
    /// The .fmu file to write; default: that of the folder's name, beside it
    pub(crate) output: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct SchemaOf {
    /// What it describes: problem files, what a command prints with --json, or its errors
    #[arg(long, value_name = "DOCUMENT", default_value = "problem")]
    pub(crate) of: Document,
}

/// A document that has a schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Document {
    Problem,
    Info,
    Validate,
    Check,
    Fit,
    Error,
}

#[derive(Debug, Args)]
pub(crate) struct Completions {
    /// The shell
    pub(crate) shell: clap_complete::Shell,
}
