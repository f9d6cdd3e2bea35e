//! A page to watch a running fit, served on this machine only.
//!
//! It is part of this crate because the command line and the Python module both show it. It also shares its
//! figures with the report. `request` and `response` implement HTTP, `server` listens, and `page` checks
//! access and routes requests.

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

/// Time to wait for the last request of a browser; browsers request the state of a fit once per second.
const LAST_LOOK: Duration = Duration::from_secs(2);

/// A page that shows a running fit, and its report afterwards. It is served on the loopback address, at a
/// random port, under an unguessable path. It does not load external resources. Dropping the value stops the
/// server.
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
/// let is_requested = || watch.is_stop_requested();
/// let mut options = FitOptions { context: RunContext::new().polling(&is_requested), ..FitOptions::default() };
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
    /// Serves the page of a fit that is about to start.
    ///
    /// # Errors
    /// Returns an error if no port is free, or if the system provides no random numbers.
    pub fn start(calibration: &Calibration) -> io::Result<Self> {
        let page = Arc::new(Page::new(calibration, token()?, token()?));
        let server = Server::start(Arc::clone(&page))?;
        Ok(Self { page, server })
    }

    /// Returns the address of the page. Anyone who knows the address can watch the fit and end it.
    pub fn url(&self) -> String {
        format!("http://{}/{}/", self.server.address(), self.page.token())
    }

    /// Attaches the page to the options of a fit, which then reports its progress.
    pub fn attach(&self, options: &mut FitOptions<'_>) {
        options.live = Some(Arc::clone(self.page.live()));
        options.phase = Arc::clone(self.page.phase());
    }

    /// True after the user has pressed the button that ends the fit. Use it in the interrupt check of the
    /// fit's context.
    pub fn is_stop_requested(&self) -> bool {
        self.page.is_stop_requested()
    }

    /// True after the reader has closed the page.
    pub fn is_closed(&self) -> bool {
        self.server.is_closed()
    }

    /// Shows the report of the fit from now on, see [`Calibration::report`]. If the button that ends the fit
    /// was pressed, nothing is simulated for the report. The responses then come from the search, at the
    /// measured times.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::report`], except errors of the file.
    pub fn show_report(
        &self,
        calibration: &Calibration,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<(), CalibrationError> {
        let report = match self.is_stop_requested() {
            true => calibration.report_page_with(fit, &self.page.curves()),
            false => calibration.report_page(fit, context)?,
        };
        self.page.set_report(report);
        Ok(())
    }

    /// Shows the reason why there is no fit. If a browser has shown the running fit, it waits up to two
    /// seconds until the browser has loaded the reason.
    pub fn show_error(&self, message: &str) {
        self.page.set_report(error_page(message));
        let began = Instant::now();
        while self.page.has_reader() && began.elapsed() < LAST_LOOK {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
