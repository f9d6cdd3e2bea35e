//! Arguments of the command line and the text of `--help`.

use crate::error::Error;
use calibration::{JobFolder, SimulationSettings};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use fmi::Fmu;
use fmi::platform::BuildTarget;
use std::path::{Path, PathBuf};

/// Fit the parameters of Functional Mock-up Units (FMUs) to measurements.
#[derive(Debug, Parser)]
#[command(
    name = "fmufit",
    version,
    arg_required_else_help = true,
    after_help = "A first fit:\n  \
        fmufit info plant.fmu                      shows the contents of the model\n  \
        fmufit init plant.fmu run.csv problem.toml writes a commented problem file to edit\n  \
        fmufit check problem.toml                  checks the problem for mistakes\n  \
        fmufit fit problem.toml --save plant.fit   fits the parameters\n  \
        fmufit report plant.fit plant.html         writes a page with figures\n\n\
        Exit codes:\n  \
        0    success\n  \
        1    the command ran to its end without success\n  \
        2    an argument, a file or a value is invalid\n  \
        3    the fit ran, but its result should not be used; its error findings give the reasons\n  \
        130  interrupted by Ctrl-C, SIGTERM or the button of --watch; a fit prints and saves its best point"
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
    /// Show the contents of a model: interfaces, default experiment, variables
    #[command(
        after_help = "Example:\n  fmufit info plant.fmu --causality parameter\n\nDoes not run code of the model."
    )]
    Info(Info),
    /// Report violations of the FMI standard and simulate a model in a separate process
    #[command(
        after_help = "Example:\n  fmufit validate plant.fmu --timeout 20\n\nExits with 1 if the model cannot be simulated."
    )]
    Validate(Validate),
    /// Simulate a model and write the result as a CSV table
    #[command(
        after_help = "Examples:\n  fmufit simulate plant.fmu --final-time 40 --set friction=0.01 --output run.csv\n  \
            fmufit simulate plant.fmu --input recorded.csv --outputs T --outputs 'tank.*' --plot run.svg"
    )]
    Simulate(Simulate),
    /// Write a commented problem file from a model and a recording
    #[command(after_help = "Example:\n  \
            fmufit init plant.fmu run.csv problem.toml\n\n\
            Matches outputs and inputs with columns by name. Parameters that do not affect any output\n\
            at the start values are written as comments.")]
    Init(Init),
    /// Check a problem for mistakes before a fit
    #[command(
        after_help = "Example:\n  fmufit check problem.toml --preflight\n\nExits with 1 if an error was found."
    )]
    Check(Check),
    /// Fit parameters to recordings
    #[command(after_help = "Examples:\n  \
        fmufit fit problem.toml --save plant.fit --report plant.html\n  \
        fmufit fit furuta.fmu furuta.csv --output armJoint.phi=phi --parameter armFriction=0.012:0:0.022\n  \
        fmufit fit problem.toml --option method=de --option max_time=60 --setting solver=radau5\n\n\
        Ctrl-C ends the fit; the best point is printed and saved (exit code 130).\n\
        Exits with 1 if the search did not converge. Exits with 3 if it converged but a finding is an \
        error,\n\
        for example a simulation that fits worse than a constant.")]
    Fit(Fit),
    /// Search for the best design of a model: minimise or maximise a criterion of its simulations
    #[command(after_help = "Example:\n  \
            fmufit optimize controller.toml --checkpoint controller.ckpt\n\n\
            The problem file has an objective such as objective = \"itae(e1)\", parameters, and optionally\n\
            constraints and [[scenarios]]. An existing checkpoint is continued.\n\n\
            With a list of objectives, the search returns their Pareto front: designs of which none is better\n\
            in all of them.\n\n\
            Exits with 1 if the search did not converge or a constraint is violated. A search for a front\n\
            exits with 1 only if no design satisfies the constraints.")]
    Optimize(Optimize),
    /// Estimate the effect of each parameter over its whole range, before a fit or a design
    #[command(after_help = "Examples:\n  \
            fmufit sensitivity problem.toml --rng 1\n  \
            fmufit sensitivity controller.toml --method sobol -n 64 --json\n\n\
            Every parameter requires finite bounds. The effects are those on the cost and on the RMS error of\n\
            each output, or on the objectives and criteria of a design.")]
    Sensitivity(Sensitivity),
    /// Continue a fit from its checkpoint
    #[command(after_help = "Example:\n  \
            fmufit fit problem.toml --checkpoint plant.ckpt     (Ctrl-C, a reboot)\n  \
            fmufit resume problem.toml --checkpoint plant.ckpt\n\n\
            The result is bit-for-bit identical to the result of an uninterrupted fit.")]
    Resume(Fit),
    /// Run a fit as independent jobs that share a folder, for example on a cluster
    #[command(
        subcommand,
        after_help = "Example:\n  \
            fmufit jobs init problem.toml --jobs 8     creates the folder problem.jobs\n  \
            fmufit jobs run problem.toml               in each job, on any machine that sees the folder\n  \
            fmufit jobs status problem.toml            shows the progress\n  \
            fmufit report problem.jobs/result.fit plant.html\n\n\
            Jobs may start and die at any time. The result is bit-for-bit identical to the result of\n\
            `fmufit fit` with the same options and number of workers."
    )]
    Jobs(Jobs),
    /// Write the report of a saved fit as a page or as a file for other programs
    #[command(after_help = "Examples:\n  \
            fmufit report plant.fit plant.html    page with tables and figures\n  \
            fmufit report plant.fit plant.csv     table of parameters\n  \
            fmufit report plant.fit plant.ssv     parameters for SSP tools\n  \
            fmufit report plant.fit plant.json    all numbers")]
    Report(Report),
    /// Compile a source-code FMU for this platform, or for Windows
    #[command(after_help = "Examples:\n  \
            fmufit build plant/ plant.fmu\n  \
            fmufit build plant/ plant.fmu --platform win64\n\n\
            Compiles the sources of the model with a C compiler of this machine.")]
    Build(Build),
    /// Write the JSON schema of problem files or of a result to the standard output
    #[command(after_help = "Example:\n  \
            fmufit schema > problem.schema.json\n\n\
            TOML editors check problem files against the schema and complete their fields. The first line\n\
            of a file written by init refers to problem.schema.json.")]
    Schema(SchemaOf),
    /// Write the completion script of a shell to the standard output
    #[command(
        after_help = "Example:\n  fmufit completions bash > ~/.local/share/bash-completion/completions/fmufit"
    )]
    Completions(Completions),
    /// Serve as the process in which another program runs its models; started by that program
    #[command(hide = true)]
    Worker,
}

impl Command {
    /// True if the command prints results and errors as JSON.
    pub(crate) fn is_json(&self) -> bool {
        match self {
            Self::Info(Info { json, .. })
            | Self::Validate(Validate { json, .. })
            | Self::Check(Check { json, .. })
            | Self::Fit(Fit { json, .. })
            | Self::Resume(Fit { json, .. })
            | Self::Optimize(Optimize { json, .. })
            | Self::Sensitivity(Sensitivity { json, .. })
            | Self::Jobs(Jobs::Run(JobsRun { json, .. }) | Jobs::Status(JobsStatus { json, .. })) => *json,
            Self::Jobs(Jobs::Next(_)) => true,
            _ => false,
        }
    }
}

/// Limits for opening a model.
#[derive(Debug, Args)]
pub(crate) struct Limits {
    /// Maximum size of modelDescription.xml, in bytes; default: 64 MiB
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
    /// Show all variables, including internal ones
    #[arg(long)]
    pub(crate) all: bool,
    /// Show only variables of this causality: parameter, input, output, local and so on
    #[arg(long, value_name = "WORD")]
    pub(crate) causality: Option<String>,
    /// Print a JSON document with all variables
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Validate {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// Time limit of the simulation, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    pub(crate) timeout: f64,
    /// Confine the model: it writes only into a separate folder and opens no connections (Linux)
    #[arg(long)]
    pub(crate) sandbox: bool,
    /// Print a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Simulate {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// Value of a parameter, start value of a variable, or all values of an SSP parameter file; may be given
    /// several times
    #[arg(long = "set", value_name = "NAME=VALUE | @FILE.ssv")]
    pub(crate) values: Vec<String>,
    /// Value of a continuous state at the start, even if the initialization computes another one (model
    /// exchange); may be given several times
    #[arg(long = "initial-state", value_name = "NAME=NUMBER")]
    pub(crate) initial_states: Vec<String>,
    /// CSV file with a column `time` and one column per input or tunable parameter of the same name
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) input: Option<PathBuf>,
    /// Name of its time column, if it is not `time`
    #[arg(long, value_name = "COLUMN", requires = "input")]
    pub(crate) time: Option<String>,
    /// Unit of a variable for which the model declares none; may be given several times
    #[arg(long, value_name = "VARIABLE=UNIT")]
    pub(crate) unit: Vec<String>,
    /// File for the table; default, and -: standard output
    #[arg(short, long, value_name = "FILE.csv")]
    pub(crate) output: Option<PathBuf>,
    /// Variables to record: names, patterns with * and ?, or `all`; default: outputs and states
    #[arg(long, value_name = "NAME")]
    pub(crate) outputs: Vec<String>,
    /// Start time of the simulation, in s; default: the start time of the model, otherwise 0
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) start_time: Option<f64>,
    /// Final time of the simulation, in s; default: the stop time of the model
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) final_time: Option<f64>,
    /// Row spacing, in s; default: 500 intervals
    #[arg(long, value_name = "SECONDS")]
    pub(crate) interval: Option<f64>,
    /// Integration method
    #[arg(long, value_name = "NAME")]
    pub(crate) solver: Option<String>,
    /// Interface: ME (model exchange) or CS (co-simulation)
    #[arg(long, value_name = "NAME")]
    pub(crate) kind: Option<String>,
    /// Relative tolerance; default: the tolerance of the model, otherwise 1e-6
    #[arg(long, value_name = "NUMBER")]
    pub(crate) tolerance: Option<f64>,
    /// Step size of a fixed-step method or communication step size of a co-simulation, in s
    #[arg(long, value_name = "SECONDS")]
    pub(crate) step_size: Option<f64>,
    /// Limit of wall-clock time, in seconds
    #[arg(long, value_name = "SECONDS")]
    pub(crate) timeout: Option<f64>,
    /// Plot the result to a file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Run the model in this process
    #[arg(long, conflicts_with = "sandbox")]
    pub(crate) in_process: bool,
    /// Confine the model: it writes only into a separate folder and opens no connections (Linux)
    #[arg(long)]
    pub(crate) sandbox: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Init {
    /// An .fmu file, or an unpacked folder
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// A recording: a CSV file with a time column
    pub(crate) data: PathBuf,
    /// The file to write
    #[arg(default_value = "problem.toml")]
    pub(crate) problem: PathBuf,
    /// A variable and the column with its measurements; may be given several times
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) output: Vec<String>,
    /// An input and the column with its values; may be given several times
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) input: Vec<String>,
    /// A parameter to fit; may be given several times. Default: all parameters that affect an output
    #[arg(long, value_name = "NAME")]
    pub(crate) parameter: Vec<String>,
    /// Name of the time column, if it is not `time`
    #[arg(long, value_name = "COLUMN")]
    pub(crate) time: Option<String>,
    /// Do not run code of the model; all parameters are proposed
    #[arg(long)]
    pub(crate) no_run: bool,
    /// Confine the model, here and in fits of the problem: it writes only into a separate folder and opens no
    /// connections (Linux)
    #[arg(long)]
    pub(crate) sandbox: bool,
    /// Replace an existing file
    #[arg(long)]
    pub(crate) force: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(flatten)]
    pub(crate) problem: Problem,
    /// Do not run simulations
    #[arg(long)]
    pub(crate) no_run: bool,
    /// Also vary each parameter: report which parameters have an effect, which are confounded, and how long a
    /// fit will take
    #[arg(long, conflicts_with = "no_run")]
    pub(crate) preflight: bool,
    /// Print a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

/// A problem, given as a file or as a model and a recording with names.
#[derive(Debug, Args)]
pub(crate) struct Problem {
    /// A problem file (see `fmufit init`; - is the standard input) or a model
    #[arg(value_name = "PROBLEM.toml | MODEL.fmu")]
    pub(crate) problem: PathBuf,
    /// With a model: the recording, a CSV file
    pub(crate) data: Option<PathBuf>,
    /// With a model: a variable and the column with its measurements; may be given several times
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) output: Vec<String>,
    /// With a model: an input, and the column or the number for its values; may be given several times.
    /// Default: the columns with the names of inputs
    #[arg(long, value_name = "VARIABLE=COLUMN")]
    pub(crate) input: Vec<String>,
    /// With a model: an input that switches, so that its values are held between the rows; may be given
    /// several times
    #[arg(long, value_name = "VARIABLE")]
    pub(crate) hold: Vec<String>,
    /// With a model: a parameter, its start value and its bounds; may be given several times
    #[arg(long, value_name = "NAME=START:LOWER:UPPER")]
    pub(crate) parameter: Vec<String>,
    /// With a model: a state and its initial value, `measured`, or a start value and bounds to fit it; may be
    /// given several times
    #[arg(long, value_name = "NAME=VALUE")]
    pub(crate) initial_state: Vec<String>,
    /// With a model: name of the time column, if it is not `time`
    #[arg(long, value_name = "COLUMN")]
    pub(crate) time: Option<String>,
    /// With a model: time in the recording, in s, at which the model has its start values, as in
    /// [[experiments]]; default: the start time of the model, usually 0
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) start_time: Option<f64>,
    /// Unit of a variable for which the model declares none; may be given several times
    #[arg(long, value_name = "VARIABLE=UNIT")]
    pub(crate) unit: Vec<String>,
    /// A simulation setting, as in [settings]; may be given several times
    #[arg(short = 'S', long, value_name = "NAME=VALUE")]
    pub(crate) setting: Vec<String>,
    /// Confine the model: it writes only into a separate folder and opens no connections (Linux); alias of
    /// --setting sandbox=true
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
    /// File for the state of the fit, for `fmufit resume`
    #[arg(long, value_name = "FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// Save the fit, for `fmufit report` and `pydfo.load_fit`
    #[arg(short, long, value_name = "FILE.fit")]
    pub(crate) save: Option<PathBuf>,
    /// Write a page with tables and figures (.html), or another format of `fmufit report`
    #[arg(short, long, value_name = "FILE.html")]
    pub(crate) report: Option<PathBuf>,
    /// Show the running fit on a local page, whose address is printed. A button on the page ends the fit.
    /// Afterwards, the page shows the report; on a terminal, until Ctrl-C
    #[arg(long)]
    pub(crate) watch: bool,
    /// Print the result as a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Optimize {
    /// A problem file with an objective, or with a list of objectives
    #[arg(value_name = "PROBLEM.toml")]
    pub(crate) problem: PathBuf,
    /// An option of the search, as in [fit]; may be given several times
    #[arg(short = 'O', long, value_name = "NAME=VALUE")]
    pub(crate) option: Vec<String>,
    /// A setting of the simulations, as in [settings]; may be given several times
    #[arg(short = 'S', long, value_name = "NAME=VALUE")]
    pub(crate) setting: Vec<String>,
    /// File for the state of the search, which is continued if it exists
    #[arg(long, value_name = "FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// Write a page with tables and figures; for a list of objectives, a table (.csv, .json) or a figure
    /// (.svg)
    #[arg(short, long, value_name = "FILE")]
    pub(crate) report: Option<PathBuf>,
    /// Show the running search on a local page, whose address is printed. A button on the page ends the
    /// search
    #[arg(long)]
    pub(crate) watch: bool,
    /// Print the result as a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Sensitivity {
    #[command(flatten)]
    pub(crate) problem: Problem,
    /// Method of the analysis
    #[arg(long, value_name = "NAME", default_value = "morris")]
    pub(crate) method: SensitivityName,
    /// Number of trajectories (morris, default 10) or rows (sobol, default 1024; a power of two)
    #[arg(short)]
    pub(crate) n: Option<usize>,
    /// Number of levels of each parameter, even (morris); default: 4
    #[arg(long, value_name = "N")]
    pub(crate) levels: Option<usize>,
    /// Also estimate the effects of pairs of parameters (sobol)
    #[arg(long)]
    pub(crate) second_order: bool,
    /// Level of the confidence intervals
    #[arg(long, value_name = "NUMBER", default_value_t = 0.95)]
    pub(crate) level: f64,
    /// Seed of the random numbers; default: drawn, or 0 with a checkpoint
    #[arg(long, value_name = "SEED")]
    pub(crate) rng: Option<u64>,
    /// Number of simulations in parallel; default: all cores. The result does not depend on it
    #[arg(long, value_name = "N")]
    pub(crate) workers: Option<usize>,
    /// Limit of wall-clock time, in seconds. The result then contains the effects from the completed points
    #[arg(long, value_name = "SECONDS")]
    pub(crate) max_time: Option<f64>,
    /// File with the completed simulations, which is continued if it exists
    #[arg(long, value_name = "FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// Print the result, with all points and values, as a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

/// Method of a sensitivity analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum SensitivityName {
    /// Screening by elementary effects, n (D + 1) simulations for D parameters
    Morris,
    /// Parts of the variance (Sobol' indices), n (D + 2) simulations
    Sobol,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Jobs {
    /// Create the folder of a fit
    Init(JobsInit),
    /// Work on the fit until it ends: evaluate points, and drive the search if no other job does
    Run(JobsRun),
    /// Take a point for another program and print it as a JSON document
    Next(JobsNext),
    /// Store the answer of another program at a point
    Tell(JobsTell),
    /// Show the progress of the fit
    Status(JobsStatus),
}

/// A fit and its folder.
#[derive(Debug, Args)]
pub(crate) struct JobsProblem {
    /// A problem file (see `fmufit init`)
    #[arg(value_name = "PROBLEM.toml")]
    pub(crate) problem: PathBuf,
    /// The folder that the jobs share; default: named after the problem file, next to it
    #[arg(long, value_name = "FOLDER")]
    pub(crate) folder: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct JobsInit {
    #[command(flatten)]
    pub(crate) at: JobsProblem,
    /// Number of jobs that will work at the same time; the search plans for it, and the result depends on the
    /// plan. More or fewer jobs give the same result
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) jobs: u64,
    /// An option of the fit, as in [fit]; may be given several times
    #[arg(short = 'O', long, value_name = "NAME=VALUE")]
    pub(crate) option: Vec<String>,
    /// Time without a sign of life after which a job counts as lost and its point is evaluated again
    #[arg(long, value_name = "SECONDS", default_value_t = JobFolder::DEFAULT_LEASE,
        value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) lease: u64,
}

#[derive(Debug, Args)]
pub(crate) struct JobsRun {
    #[command(flatten)]
    pub(crate) at: JobsProblem,
    /// Print the result as a JSON document, if this job ends the fit
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct JobsNext {
    #[command(flatten)]
    pub(crate) at: JobsProblem,
    /// Time for the answer; the point is then given to another job
    #[arg(long, value_name = "SECONDS", default_value_t = 3600, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) lease: u64,
}

#[derive(Debug, Args)]
pub(crate) struct JobsTell {
    #[command(flatten)]
    pub(crate) at: JobsProblem,
    /// The point, as printed by `fmufit jobs next`
    pub(crate) point: String,
    /// File with the weighted residuals as numbers, in the order experiment, output, time; default: the
    /// standard input
    #[arg(long, value_name = "FILE")]
    pub(crate) residuals: Option<PathBuf>,
    /// The simulation failed at this point, for this reason
    #[arg(long, value_name = "REASON", conflicts_with = "residuals")]
    pub(crate) failed: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct JobsStatus {
    #[command(flatten)]
    pub(crate) at: JobsProblem,
    /// Print a JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Report {
    /// A saved fit
    pub(crate) fit: PathBuf,
    /// The file to write; its suffix determines the format: .html, .csv, .json, .ssv
    pub(crate) output: PathBuf,
    /// The model, if it is no longer at its original path
    #[arg(long, value_name = "MODEL.fmu")]
    pub(crate) model: Option<PathBuf>,
    /// The recording whose values go into an .ssv file, if a parameter has a value for each recording
    #[arg(long, value_name = "NAME")]
    pub(crate) experiment: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct Build {
    /// A folder with modelDescription.xml and sources/, or an .fmu file
    pub(crate) model: PathBuf,
    /// The .fmu file to write; default: named after the folder, next to it
    pub(crate) output: Option<PathBuf>,
    /// The platform of the library. The compiler is CC, or one of cc, gcc and clang. For Windows it is
    /// CC_x86_64_pc_windows_gnu or CC_i686_pc_windows_gnu, by default the compiler of MinGW-w64
    #[arg(long, value_name = "PLATFORM", default_value = "native", value_parser = platforms())]
    pub(crate) platform: BuildTarget,
}

/// Returns the parser of the platforms for which sources are compiled.
fn platforms() -> impl TypedValueParser<Value = BuildTarget> {
    PossibleValuesParser::new(BuildTarget::names()).try_map(|name| name.parse::<BuildTarget>())
}

#[derive(Debug, Args)]
pub(crate) struct SchemaOf {
    /// Subject of the schema: problem files, the --json output of a command, or its errors
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
