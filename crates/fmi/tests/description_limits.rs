//! The memory for a description is bounded by its limit, and the number of array elements is limited.
#![allow(clippy::unwrap_used, clippy::panic)]

mod zip_bytes;

use fmi::{
    Archive, CancelRequest, DescriptionLimits, FmiError, Fmu, ModelDescription, OpenOptions, SimulateOptions,
};
use std::fs;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

const LIMIT: usize = 1 << 20;

fn fmi3(types: &str, variables: &str, structure: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" instantiationToken=\"t\">\
         <ModelExchange modelIdentifier=\"m\"/><TypeDefinitions>{types}</TypeDefinitions>\
         <ModelVariables><Float64 name=\"x\" valueReference=\"0\"/>{variables}</ModelVariables>\
         <ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )
}

fn fmi2(head: &str, variables: &str, structure: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"t\"><ModelExchange modelIdentifier=\"m\"/>{head}\
         <ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )
}

/// Repeats a text up to the size limit, with numbers in place of `#`.
fn filled(text: &str) -> String {
    let mut all = String::new();
    for k in 1.. {
        let one = text.replace('#', &k.to_string());
        if all.len() + one.len() + 5000 > LIMIT {
            break;
        }
        all += &one;
    }
    all
}

/// Returns documents close to the size limit, each with a different kind of memory use.
fn hungry_documents() -> Vec<(&'static str, Vec<u8>)> {
    let words = filled("1 ");
    let (long, zeros) = ("u".repeat(1000), "0".repeat(LIMIT - 2000));
    let inherited =
        format!("<Float64Type name=\"t\" quantity=\"{long}\" unit=\"{long}\" displayUnit=\"{long}\"/>");
    let latin = |text: &str| {
        let mut bytes = b"<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>".to_vec();
        bytes.extend(text.chars().map(|c| if c == '~' { 0x80 } else { c as u8 }));
        bytes
    };
    let texts = vec![
        (
            "start list",
            fmi3(
                "",
                &format!(
                    "<Float64 name=\"a\" valueReference=\"1\" start=\"{words}\"><Dimension start=\"9\"/></Float64>"
                ),
                "",
            ),
        ),
        (
            "integers",
            fmi3(
                "",
                &format!(
                    "<Int8 name=\"a\" valueReference=\"1\" start=\"{words}\"><Dimension start=\"9\"/></Int8>"
                ),
                "",
            ),
        ),
        (
            "binary start",
            fmi3(
                "",
                &format!("<Binary name=\"a\" valueReference=\"1\"><Start value=\"{zeros}\"/></Binary>"),
                "",
            ),
        ),
        (
            "texts",
            fmi3(
                "",
                &format!(
                    "<String name=\"a\" valueReference=\"1\"><Dimension start=\"9\"/>{}</String>",
                    filled("<Start value=\"\"/>")
                ),
                "",
            ),
        ),
        (
            "dimensions",
            fmi3(
                "",
                &format!(
                    "<Float64 name=\"a\" valueReference=\"1\">{}</Float64>",
                    filled("<Dimension start=\"1\"/>")
                ),
                "",
            ),
        ),
        (
            "parametric dimensions",
            fmi3(
                "",
                &format!(
                    "<Float64 name=\"a\" valueReference=\"1\">{}</Float64>",
                    filled("<Dimension valueReference=\"0\"/>")
                ),
                "",
            ),
        ),
        (
            "aliases",
            fmi3(
                "",
                &format!(
                    "<Float64 name=\"a\" valueReference=\"1\">{}</Float64>",
                    filled("<Alias name=\"#\"/>")
                ),
                "",
            ),
        ),
        ("clocks", fmi3("", &filled("<Clock name=\"#\" valueReference=\"#\"/>"), "")),
        (
            "list of clocks",
            fmi3("", &format!("<Float64 name=\"a\" valueReference=\"1\" clocks=\"{words}\"/>"), ""),
        ),
        ("variables", fmi3("", &filled("<Int8 name=\"\" valueReference=\"#\"/>"), "")),
        (
            "many texts",
            fmi3(
                "",
                &filled(
                    "<Int8 name=\"a\" valueReference=\"#\" description=\"\" quantity=\"a\" declaredType=\"a\" unit=\"a\"/>",
                ),
                "",
            ),
        ),
        (
            "inherited texts",
            fmi3(&inherited, &filled("<Float64 name=\"\" valueReference=\"#\" declaredType=\"t\"/>"), ""),
        ),
        (
            "items",
            fmi3(
                &format!("<EnumerationType name=\"t\">{}</EnumerationType>", filled("<Item name=\"\"/>")),
                "",
                "",
            ),
        ),
        ("types", fmi3(&filled("<Int8Type name=\"\"/>"), "", "")),
        (
            "dependencies",
            fmi3("", "", &format!("<Output valueReference=\"0\" dependencies=\"{}\"/>", filled("0 "))),
        ),
        (
            "kinds",
            fmi3(
                "",
                "",
                &format!(
                    "<Output valueReference=\"0\" dependencies=\"0\" dependenciesKind=\"{}\"/>",
                    filled("fixed ")
                ),
            ),
        ),
        ("unknowns", fmi3("", "", &filled("<Output valueReference=\"0\"/>"))),
        (
            "variables of FMI 2",
            fmi2("", &filled("<ScalarVariable name=\"\" valueReference=\"0\"><Real/></ScalarVariable>"), ""),
        ),
        (
            "positions of FMI 2",
            fmi2(
                "",
                "<ScalarVariable name=\"\" valueReference=\"0\"><Real/></ScalarVariable>",
                &format!("<Outputs>{}</Outputs>", filled("<Unknown index=\"1\"/>")),
            ),
        ),
        (
            "units",
            fmi2(&format!("<UnitDefinitions>{}</UnitDefinitions>", filled("<Unit name=\"\"/>")), "", ""),
        ),
        (
            "display units",
            fmi2(
                &format!(
                    "<UnitDefinitions><Unit name=\"\">{}</Unit></UnitDefinitions>",
                    filled("<DisplayUnit name=\"\"/>")
                ),
                "",
                "",
            ),
        ),
        (
            "categories",
            fmi2(&format!("<LogCategories>{}</LogCategories>", filled("<Category name=\"\"/>")), "", ""),
        ),
        (
            "long names",
            fmi2(
                "",
                &format!(
                    "<ScalarVariable name=\"{zeros}\" valueReference=\"0\" causality=\"input\" variability=\"fixed\"><Real unit=\"x\" min=\"2\" max=\"1\" derivative=\"7\"/></ScalarVariable>"
                ),
                "",
            ),
        ),
    ];
    let wide = fmi2(
        "",
        &format!(
            "<ScalarVariable name=\"{}\" valueReference=\"0\"><Real/></ScalarVariable>",
            "~".repeat(LIMIT - 2000)
        ),
        "",
    );
    let utf16 =
        fmi2("", &filled("<ScalarVariable name=\"\" valueReference=\"0\"><Real/></ScalarVariable>"), "");
    let utf16: Vec<u8> = utf16[..LIMIT / 2 - 100].encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mut all: Vec<_> = texts.into_iter().map(|(name, text)| (name, text.into_bytes())).collect();
    all.extend([("latin-1", latin(&wide)), ("UTF-16", utf16)]);
    all
}

#[test]
fn description_memory_is_at_most_eight_times_the_limit() {
    let limits = DescriptionLimits { bytes: LIMIT as u64, ..DescriptionLimits::default() };
    let folder = tempfile::tempdir().unwrap();
    let mut refused = 0;
    for (name, document) in hungry_documents() {
        assert!(document.len() <= LIMIT, "{name}: {}", document.len());
        let path = folder.path().join("m.fmu");
        let entry = zip_bytes::Entry::deflated("modelDescription.xml", &document);
        drop(document);
        fs::write(&path, zip_bytes::zip(std::slice::from_ref(&entry))).unwrap();
        let archive = Archive::open(&path).unwrap();
        let mut outcome = None;
        let used = allocation_counter::measure(|| {
            outcome = Some(ModelDescription::read_with(&archive, &limits, &CancelRequest::default()));
        });
        // The memory for inflating does not depend on the size.
        let most = 8 * LIMIT as u64 + (512 << 10);
        assert!(used.bytes_max <= most, "{name}: {} bytes", used.bytes_max);
        let complaint = outcome.unwrap().err().map(|error| error.to_string());
        refused += usize::from(complaint.is_some_and(|text| text.contains("DescriptionLimits::bytes")));
    }
    assert!(refused > 0);
}

#[test]
fn ordinary_description_at_the_limit_is_read() {
    let limits = DescriptionLimits { bytes: LIMIT as u64, ..DescriptionLimits::default() };
    let variables = filled(
        "<ScalarVariable name=\"plant.stage[#].pipe.massFlowRate\" valueReference=\"#\" causality=\"local\" \
         variability=\"continuous\" initial=\"calculated\" description=\"mass flow rate of stage #\">\n\
         <Real declaredType=\"Modelica.Units.SI.MassFlowRate\" quantity=\"MassFlowRate\" unit=\"kg/s\" min=\"0\"/>\
         </ScalarVariable>\n",
    );
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("modelDescription.xml"), fmi2("", &variables, "")).unwrap();
    let archive = Archive::open(folder.path()).unwrap();
    let model = ModelDescription::read_with(&archive, &limits, &CancelRequest::default()).unwrap();
    assert!(model.variables.len() > 2500);
    let small = DescriptionLimits { bytes: LIMIT as u64 / 2, ..limits };
    let message =
        ModelDescription::read_with(&archive, &small, &CancelRequest::default()).unwrap_err().to_string();
    assert!(message.contains(&format!("limit of {}", LIMIT / 2)), "{message}");
}

fn folder_of(xml: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("modelDescription.xml"), xml).unwrap();
    folder
}

#[test]
fn total_number_of_array_elements_is_limited() {
    // 135 kB of arrays, each of them below any limit for one.
    let array = |extent: usize| {
        format!(
            "<Float64 name=\"a#\" valueReference=\"1#\" causality=\"output\"><Dimension start=\"{extent}\"/></Float64>"
        )
    };
    let arrays =
        |extent: usize| (0..1000).map(|k| array(extent).replace('#', &k.to_string())).collect::<String>();
    let message =
        ModelDescription::parse(fmi3("", &arrays(1_000_000), "").as_bytes()).unwrap_err().to_string();
    assert!(
        message.contains("the arrays up to \"a2\" together have more than 2000000 elements")
            && message.contains("DescriptionLimits::elements"),
        "{message}"
    );
    assert!(ModelDescription::parse(fmi3("", &arrays(2000), "").as_bytes()).is_ok());
    let folder = folder_of(&fmi3("", &arrays(10), ""));
    let open = |elements| {
        let description = DescriptionLimits { elements, ..DescriptionLimits::default() };
        Fmu::open_with(folder.path(), &OpenOptions { description, ..OpenOptions::default() })
    };
    assert!(open(10_000).is_ok());
    assert!(open(9999).unwrap_err().to_string().contains("more than 9999 elements"));
    // A single array above the limit, a product that overflows, states, and event indicators.
    let one = "<Float64 name=\"a\" valueReference=\"1\"><Dimension start=\"4294967295\"/><Dimension start=\"4294967295\"/>\
               <Dimension start=\"2\"/></Float64>";
    let message = ModelDescription::parse(fmi3("", one, "").as_bytes()).unwrap_err().to_string();
    assert!(
        message.contains("\"a\" (4294967295 x 4294967295 x 2) has more than 2000000 elements"),
        "{message}"
    );
    let vector = "<Float64 name=\"a\" valueReference=\"1\"><Dimension start=\"1000\"/></Float64>";
    let many = fmi3("", vector, &"<ContinuousStateDerivative valueReference=\"1\"/>".repeat(3000));
    let message = ModelDescription::parse(many.as_bytes()).unwrap_err().to_string();
    assert!(message.contains("the states have more than 2000000 elements"), "{message}");
    let indicators = fmi2("", "", "").replace("guid", "numberOfEventIndicators=\"3000000\" guid");
    let message = ModelDescription::parse(indicators.as_bytes()).unwrap_err().to_string();
    assert!(
        message.contains("numberOfEventIndicators=\"3000000\" exceeds the limit of 2000000"),
        "{message}"
    );
}

#[test]
fn structural_parameters_respect_element_limit() {
    let variables = "<UInt64 name=\"n\" valueReference=\"1\" causality=\"structuralParameter\" variability=\"fixed\" start=\"3\"/>\
                     <Float64 name=\"a\" valueReference=\"2\" causality=\"output\"><Dimension valueReference=\"1\"/></Float64>\
                     <Float64 name=\"b\" valueReference=\"3\" causality=\"output\"><Dimension valueReference=\"1\"/>\
                     <Dimension valueReference=\"1\"/></Float64>";
    let folder = folder_of(&fmi3("", variables, ""));
    let fmu = Fmu::open(folder.path()).unwrap();
    let options = |n: i64| SimulateOptions::new().final_time(1.0).start_value("n", n);
    assert!(fmi::SimulationPlan::new(&fmu, &options(1000)).is_ok());
    for n in [2000, 1 << 40, i64::MAX] {
        let message = fmi::SimulationPlan::new(&fmu, &options(n)).unwrap_err().to_string();
        assert!(
            message.contains("more than 2000000 elements with the specified structural parameters"),
            "{message}"
        );
    }
}

#[test]
fn number_of_folders_is_limited() {
    let mut entries = vec![zip_bytes::description()];
    let deep = "d/".repeat(60);
    entries.extend((0..1600).map(|k| zip_bytes::Entry::stored(&format!("{k}/{deep}f"), b"")));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.fmu");
    fs::write(&path, zip_bytes::zip(&entries)).unwrap();
    let message = Fmu::open(&path).unwrap_err().to_string();
    assert!(message.contains("folders, more than the limit of 10000"), "{message}");
}

#[test]
fn opening_ends_shortly_after_cancellation() {
    let flag = Arc::new(AtomicBool::new(true));
    let options = OpenOptions { cancel: CancelRequest::when(Arc::clone(&flag)), ..OpenOptions::default() };
    let folder = folder_of(&fmi3("", "", ""));
    assert!(matches!(Fmu::open_with(folder.path(), &options), Err(FmiError::Cancelled)));
    flag.store(false, std::sync::atomic::Ordering::Relaxed);
    let fmu = Fmu::open_with(folder.path(), &options).unwrap();
    assert_eq!(fmu.description().variables.len(), 1);
    // In the middle of a long document.
    let long = fmi3("", &filled("<Int8 name=\"v#\" valueReference=\"#\"/>").repeat(20), "");
    let path = folder.path().join("m.fmu");
    fs::write(&path, zip_bytes::zip(&[zip_bytes::Entry::deflated("modelDescription.xml", long.as_bytes())]))
        .unwrap();
    let raising = Arc::clone(&flag);
    let raised = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(20));
        raising.store(true, std::sync::atomic::Ordering::Relaxed);
        Instant::now()
    });
    let outcome = Fmu::open_with(&path, &options);
    let ended = Instant::now();
    let late = ended.saturating_duration_since(raised.join().unwrap());
    assert!(outcome.is_ok() || late < Duration::from_millis(200), "{late:?}");
}
