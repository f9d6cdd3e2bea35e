//! A page to look at while a fit runs, on this machine alone.
//!
//! It belongs here because both the command line and the Python module show it, and because its figures are
//! those of the report. `request` and `response` know HTTP, `server` listens, `page` refuses what has no
//! right to it and says what is where.

mod page;
mod request;
mod response;
mod server;

use crate::error::CalibrationError;
use crate::fit::one_stage::{Fit, FitOptions};
use crate::loaded::calibration::Calibration;
use crate::report::live_content::error_page;
use base::RunContext;
use page::{Page, token};
use server::Server;
use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Browsers look at the state of a fit once in a second.
const LAST_LOOK: Duration = Duration::from_secs(2);

/// A page that shows a fit while it runs, and its report afterwards. It is served on the loopback address,
/// at a random port, under a path that nobody can guess; it needs nothing from anywhere else. Dropping this
/// ends it.
///
/// ```
/// # use calibration::{Calibration, Data, Experiment, FitOptions, Parameter, RunContext, LivePage};
/// # let t = vec![0.0, 0.5, 1.0, 1.5];
/// # let x = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
/// # let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist")?)?;
/// # let calibration = Calibration::builder(fmu)
/// #     .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)])?).output("x", "x"))
/// #     .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
/// #     .build()?;
/// let watch = LivePage::start(&calibration)?;
/// println!("{}", watch.url());
/// let is_asked = || watch.is_stop_asked();
/// let mut options = FitOptions { context: RunContext::new().asking(&is_asked), ..FitOptions::default() };
/// watch.attach(&mut options);
/// let fit = calibration.fit(options)?;
/// watch.show_report(&calibration, &fit, &RunContext::new())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LivePage {
    page: Arc<Page>,
    server: Server,
}

impl LivePage {
    /// Serves the page of a fit that is about to begin.
    ///
    /// # Errors
    /// There is no free port, or the system gives no random numbers.
    pub fn start(calibration: &Calibration) -> io::Result<Self> {
        let page = Arc::new(Page::new(calibration, token()?, token()?));
        let server = Server::start(Arc::clone(&page))?;
        Ok(Self { page, server })
    }

    /// Address of the page. Whoever knows it can look at the fit and end it.
    pub fn url(&self) -> String {
        format!("http://{}/{}/", self.server.address(), self.page.token())
    }

    /// Has a fit say what it does.
    pub fn attach(&self, options: &mut FitOptions<'_>) {
        options.live = Some(Arc::clone(self.page.live()));
        options.phase = Arc::clone(self.page.phase());
    }

    /// True once the button that ends the fit was pressed. The context of the fit is to ask for it.
    pub fn is_stop_asked(&self) -> bool {
        self.page.is_stop_asked()
    }

    /// True once the page was closed by its reader.
    pub fn is_closed(&self) -> bool {
        self.server.is_closed()
    }

    /// Shows the report of the fit from now on, see [`Calibration::report`]. After the button that ends the
    /// fit nothing is simulated for it: the responses are those that the search has computed, at the measured
    /// times.
    ///
    /// # Errors
    /// As of a report that is written.
    pub fn show_report(
        &self,
        calibration: &Calibration,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<(), CalibrationError> {
        let report = match self.is_stop_asked() {
            true => calibration.report_page_with(fit, &self.page.curves()),
            false => calibration.report_page(fit, context)?,
        };
        self.page.set_report(report);
        Ok(())
    }

    /// Shows why there is no fit, and waits until a browser that has shown the running fit has taken it: a
    /// second or two, not at all where there is none.
    pub fn show_error(&self, message: &str) {
        self.page.set_report(error_page(message));
        let began = Instant::now();
        while self.page.has_reader() && began.elapsed() < LAST_LOOK {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
