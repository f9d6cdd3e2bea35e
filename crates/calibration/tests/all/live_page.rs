//! Requests to the page of a running fit: access, contents, ending the fit, and resistance to other clients.

use calibration::{Calibration, Data, Experiment, Fit, FitOptions, LivePage, Parameter, RunContext};
use dfo::{DifferentialEvolution, Limits, RunOptions, Termination, Tolerances};
use fmi::RunSettings;
use ode::Method;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::ops::ControlFlow;

fn decay() -> Calibration {
    decay_by(RunSettings::default())
}

/// Returns a calibration with slow simulations, so that a fit does not end by itself during the test.
fn slow_decay() -> Calibration {
    decay_by(RunSettings { method: Method::Rk4, step_size: Some(1e-5), ..RunSettings::default() })
}

fn decay_by(settings: RunSettings) -> Calibration {
    let t: Vec<f64> = (0..51).map(|i| 0.1 * f64::from(i)).collect();
    let x = t.iter().map(|t| (-2.0 * t).exp()).collect();
    let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
    Calibration::builder(fmu)
        .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0).display_name("rate <of> decay"))
        .settings(settings)
        .build()
        .unwrap()
}

/// Returns the options of a fit that ends only on request.
fn endless<'a>() -> FitOptions<'a> {
    let tolerances = Tolerances { x_tol: 0.0, f_tol: 0.0, ..FitOptions::default_run().tolerances };
    let limits = Limits { max_evaluations: Some(1_000_000_000), ..Limits::default() };
    let method = DifferentialEvolution::default().into();
    RunOptions { method, tolerances, limits, seed: Some(1), workers: Some(2), ..FitOptions::default_run() }
        .into()
}

/// Returns the host and the path of a page.
fn place(page: &LivePage) -> (String, String) {
    let url = page.url();
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    (host.to_owned(), format!("/{path}"))
}

/// Sends these bytes and returns the status line and the whole text of the answer.
fn sent(host: &str, bytes: &[u8]) -> (String, String) {
    let mut stream = TcpStream::connect(host).unwrap();
    // A server that has read enough answers and closes the connection early.
    let _ = stream.write_all(bytes);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    let answer = String::from_utf8(answer).unwrap();
    (answer.lines().next().unwrap_or_default().to_owned(), answer)
}

fn requested(host: &str, method: &str, path: &str, headers: &str) -> (String, String) {
    sent(host, format!("{method} {path} HTTP/1.1\r\n{headers}\r\n").as_bytes())
}

#[test]
fn page_is_served_only_to_clients_with_the_token() {
    let page = LivePage::start(&decay()).unwrap();
    let (host, path) = place(&page);
    assert!(host.starts_with("127.0.0.1:") && path.len() > 32, "{}", page.url());
    let port = host.rsplit_once(':').unwrap().1;
    let host_header = format!("Host: {host}\r\n");
    let good = requested(&host, "GET", &path, &host_header);
    assert!(good.0 == "HTTP/1.1 200 OK" && good.1.contains("rate &lt;of&gt; decay"), "{}", good.1);
    assert!(good.1.contains("Content-Security-Policy: default-src 'none'"), "{}", good.1);
    // The page must not load anything from other hosts.
    let elsewhere = good.1.replace("http://www.w3.org/2000/svg", "");
    assert!(
        !["http:", "https:", "//", "@import", "url("].iter().any(|text| elsewhere.contains(text)),
        "{elsewhere}"
    );
    let other_token = "0".repeat(32);
    let from = |origin: &str| format!("{host_header}Origin: {origin}\r\n");
    for (method, path, headers, status) in [
        ("GET", path.as_str(), format!("host: LOCALHOST:{port}\r\n"), "200"),
        ("GET", &format!("{path}state"), host_header.clone(), "200"),
        // Wrong or missing tokens, other paths.
        ("GET", "/", host_header.clone(), "404"),
        ("GET", &format!("/{other_token}/"), host_header.clone(), "404"),
        ("POST", &format!("/{other_token}/stop"), host_header.clone(), "404"),
        ("GET", &path[..path.len() - 1], host_header.clone(), "404"),
        ("GET", &format!("{path}../"), host_header.clone(), "404"),
        ("GET", &format!("{path}state?x"), host_header.clone(), "404"),
        ("GET", &format!("http://{host}{path}"), host_header.clone(), "404"),
        // Sites whose names resolve to this address.
        ("GET", &path, format!("Host: rebound.example:{port}\r\n"), "403"),
        ("GET", &path, "Host: 127.0.0.1\r\n".to_owned(), "403"),
        ("GET", &path, String::new(), "403"),
        ("GET", &path, format!("{host_header}{host_header}"), "403"),
        ("POST", &format!("{path}stop"), from("http://rebound.example"), "403"),
        ("POST", &format!("{path}stop"), from("null"), "403"),
        // Methods.
        ("GET", &format!("{path}stop"), host_header.clone(), "405"),
        ("GET", &format!("{path}close"), host_header.clone(), "405"),
        ("POST", &path, host_header.clone(), "405"),
        ("DELETE", &format!("{path}state"), host_header.clone(), "405"),
        // Sizes.
        ("GET", &path, format!("{host_header}A: {}\r\n", "a".repeat(100_000)), "413"),
        ("GET", &format!("{path}{}", "a".repeat(100_000)), host_header.clone(), "413"),
        ("POST", &format!("{path}stop"), format!("{host_header}Content-Length: 99999999999\r\n"), "413"),
        ("POST", &format!("{path}stop"), format!("{host_header}Content-Length: minus\r\n"), "400"),
        ("POST", &format!("{path}stop"), format!("{host_header}Transfer-Encoding: chunked\r\n"), "413"),
    ] {
        let (line, text) = requested(&host, method, path, &headers);
        let shown = format!("{method} {path:.80} {headers:.80}: {line}");
        assert!(line.starts_with(&format!("HTTP/1.1 {status} ")), "{shown}");
        assert!(status == "200" || !text.contains("decay"), "{shown}");
    }
    assert!(sent(&host, b"\x16\x03\x01 no HTTP\r\n\r\n").0.contains(" 400 "));
    let (line, text) = requested(&host, "HEAD", &path, &host_header);
    assert!(line.contains(" 200 ") && text.ends_with("\r\n\r\n"), "{text}");
    assert!(!page.is_stop_requested() && !page.is_closed());
    // Without a report, a request cannot close the page.
    assert!(
        requested(&host, "POST", &format!("{path}close"), &host_header).0.contains(" 303 ")
            && !page.is_closed()
    );
    drop(page);
    // The listening thread ends by itself.
    let is_refused = |_| {
        std::thread::sleep(std::time::Duration::from_millis(20));
        TcpStream::connect(&host).is_err()
    };
    assert!((0..500).any(is_refused));
}

#[test]
fn stop_button_ends_the_fit_with_the_best_point() {
    let calibration = slow_decay();
    let page = LivePage::start(&calibration).unwrap();
    let (host, path) = place(&page);
    let host_header = format!("Host: {host}\r\n");
    let state = || requested(&host, "GET", &format!("{path}state"), &host_header).1;
    // These clients send nothing, send a part of a request, or do not read the answer.
    let hanging: Vec<TcpStream> = (0..12)
        .map(|k| {
            let mut stream = TcpStream::connect(&host).unwrap();
            let part = format!("GET {path} HTTP/1.1\r\n{host_header}\r\n");
            stream.write_all(&part.as_bytes()[..[0, 10, part.len()][k % 3]]).unwrap();
            stream
        })
        .collect();
    let fit = std::thread::scope(|scope| {
        let run = scope.spawn(|| {
            let is_requested = || page.is_stop_requested();
            let mut options = FitOptions { context: RunContext::new().polling(&is_requested), ..endless() };
            page.attach(&mut options);
            calibration.fit(options).unwrap()
        });
        let mut seen = state();
        while !(seen.contains("Convergence") && seen.matches("<svg viewBox=\"0 0 34").count() == 4) {
            assert!(!run.is_finished(), "{seen}");
            seen = state();
        }
        assert!(seen.contains("now searching: iteration ") && seen.contains("0.1 to 10"), "{seen}");
        // The page shows measured and simulated values with the residuals below, and the costs.
        assert!(seen.matches("role=\"img\"").count() == 2 && seen.contains("residual"), "{seen}");
        let (line, text) =
            requested(&host, "POST", &format!("{path}stop"), &format!("{host_header}Content-Length: 0\r\n"));
        assert!(line.contains(" 303 ") && text.contains("Location: ./\r\n"), "{text}");
        run.join().unwrap()
    });
    assert_eq!(fit.report.termination, Termination::Interrupted);
    let costs = fit.report.trace.iter().filter_map(|entry| Some((entry.outcome.value()?, entry.x)));
    let best = costs.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    assert_eq!((fit.cost, fit.x.as_slice()), best);
    // The page now shows the report, which requires no simulation. A context that has ended would end a
    // simulation.
    let is_over = || true;
    page.show_report(&calibration, &fit, &RunContext::new().polling(&is_over)).unwrap();
    assert!(state().starts_with("HTTP/1.1 205 "));
    let report = requested(&host, "GET", &path, &host_header).1;
    assert!(report.contains("The fit was interrupted") && report.contains("action=\"close\""), "{report}");
    assert!(report.contains("Measured and simulated") && report.contains("Figure: x"), "{report}");
    let (line, text) = requested(&host, "POST", &format!("{path}close"), &host_header);
    assert!(line.contains(" 200 ") && text.contains("The page is closed"), "{text}");
    while !page.is_closed() {
        std::thread::yield_now();
    }
    drop((page, hanging));
}

#[test]
fn page_responds_when_other_clients_send_nothing() {
    let page = LivePage::start(&decay()).unwrap();
    let (host, path) = place(&page);
    let host_header = format!("Host: {host}\r\n");
    let hanging: Vec<TcpStream> = (0..32).map(|_| TcpStream::connect(&host).unwrap()).collect();
    // The owner is served after a short timeout of the silent clients, although all of them stay connected.
    while !requested(&host, "GET", &path, &host_header).0.contains(" 200 ") {
        std::thread::yield_now();
    }
    drop(hanging);
}

/// Costs, evaluated points and simulations are equal with and without a viewer.
#[test]
fn live_page_does_not_change_fit_result() {
    let fitted = |page: Option<(&LivePage, &str, &str)>| -> (Fit, usize) {
        let calibration = decay();
        let mut n_seen = 0;
        let mut options = FitOptions {
            observer: Some(Box::new(|_| {
                if let Some((_, host, path)) = page {
                    let (line, _) =
                        requested(host, "GET", &format!("{path}state"), &format!("Host: {host}\r\n"));
                    n_seen += usize::from(line.contains(" 200 "));
                }
                ControlFlow::Continue(())
            })),
            ..endless()
        };
        options.run.workers = Some(1);
        options.run.limits.max_evaluations = Some(200);
        page.iter().for_each(|(page, ..)| page.attach(&mut options));
        let fit = calibration.fit(options).unwrap();
        (fit, n_seen)
    };
    let page = LivePage::start(&decay()).unwrap();
    let (host, path) = place(&page);
    let ((plain, _), (watched, n_seen)) = (fitted(None), fitted(Some((&page, &host, &path))));
    assert!(n_seen > 2, "{n_seen}");
    assert_eq!((&plain.x, plain.cost, plain.stats.runs), (&watched.x, watched.cost, watched.stats.runs));
    let points =
        |fit: &Fit| fit.report.trace.iter().map(|e| (e.x.to_vec(), e.outcome.value())).collect::<Vec<_>>();
    assert_eq!(points(&plain), points(&watched));
    let phases = |fit: &Fit| fit.phases.iter().map(|p| (p.phase, p.taken.simulations)).collect::<Vec<_>>();
    assert_eq!(phases(&plain), phases(&watched));
}

#[test]
fn page_shows_failed_points_with_their_reasons() {
    let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
    let t: Vec<f64> = (0..11).map(f64::from).collect();
    let x = t.iter().map(|t| (-2.0 * t).exp()).collect();
    let calibration = Calibration::builder(fmu)
        .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x"))
        // Below zero, the solution grows, and e^1000 overflows.
        .parameter(Parameter::new("k", 1.0).bounds(-100.0, 100.0))
        .build()
        .unwrap();
    let page = LivePage::start(&calibration).unwrap();
    let mut options = endless();
    options.run.limits.max_evaluations = Some(100);
    page.attach(&mut options);
    let fit = calibration.fit(options).unwrap();
    let n = fit.report.n_failed;
    let (host, path) = place(&page);
    let text = requested(&host, "GET", &format!("{path}state"), &format!("Host: {host}\r\n")).1;
    assert!(n > 0 && text.contains(&format!("Failed evaluations: {n}")), "{n}: {text}");
    let escaped = |reason: &str| reason.replace('\'', "&#x27;").replace('"', "&quot;").replace('/', "&#x2f;");
    for (reason, _) in fit.report.failures.iter().take(3) {
        assert!(text.contains(&escaped(reason)), "{reason}: {text}");
    }
}

#[test]
fn page_shows_the_error_of_a_failed_fit() {
    let calibration = decay();
    let page = LivePage::start(&calibration).unwrap();
    let (host, path) = place(&page);
    let host_line = format!("Host: {host}\r\n");
    // No client has connected, so there is no wait.
    page.show_error("no <reason>");
    let (status, text) = requested(&host, "GET", &path, &host_line);
    assert!(status.contains("200") && text.contains("no &lt;reason&gt;"), "{text}");
    assert!(requested(&host, "GET", &format!("{path}state"), &host_line).0.contains("205"));
}
