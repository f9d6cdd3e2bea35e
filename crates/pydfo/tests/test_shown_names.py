"""Names from models and recordings in messages, representations and tables: control and direction characters are
escaped."""

from __future__ import annotations

import fmus
import numpy as np
import pytest

from pydfo import BadCalibrationError, Calibration, CalibrationWarning, Experiment, Parameter, UnknownVariableError, example_fmu, read_description
from pydfo.compat import fmpy

#: A line break, a tabulator, an escape, a carriage return, a direction mark, a line separator.
ODD = "a\nb\tc\x1b[2Jd\re\u202ef\u2028g"
SHOWN = r"a\u{a}b\u{9}c\u{1b}[2Jd\u{d}e\u{202e}f\u{2028}g"
HIDDEN = set(ODD) - set("abc[2Jdefg")
TIME = np.linspace(0.0, 2.0, 21)
K = Parameter("k", 1.0, 0.1, 10.0)


def assert_is_shown(text, lines=1):
    assert SHOWN in text and not (HIDDEN - {"\n"}) & set(text), ascii(text)
    if lines == 1:
        assert "\n" not in text, ascii(text)


def data(**columns):
    return {"time": TIME, ODD: np.exp(-2.0 * TIME), **columns}


@pytest.mark.parametrize(
    ("table", "options"),
    [
        (data(), {"outputs": {"x": "y"}}),
        ({"time": TIME, ODD: TIME[:3]}, {"outputs": {"x": ODD}}),
        ({"time": TIME, ODD: ["?"] * 21}, {"outputs": {"x": ODD}}),
        ({"time": TIME, ODD: np.full(21, np.inf)}, {"outputs": {"x": ODD}}),
        ({"time": TIME, ODD: np.ones((21, 2))}, {"outputs": {"x": ODD}}),
        ({ODD: TIME, "x": TIME}, {"outputs": ["x"]}),
        ({"time": TIME, f"x [{ODD}]": TIME}, {"outputs": ["x"], "units": {"x": "m"}}),
        (data(), {"outputs": {"x": ODD}, "weights": {ODD: 1.0, "x": 1.0}}),
        (data(), {"outputs": {ODD: ODD}}),
        (data(), {"outputs": {"x": ODD}, "mask": f"no {ODD}"}),
    ],
)
def test_messages_escape_column_names(table, options):
    with pytest.raises((ValueError, KeyError)) as error:
        Calibration(example_fmu("dahlquist"), table, parameters=[K], **options)
    assert_is_shown(str(error.value))


def test_messages_escape_column_names_of_files(tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    pd.DataFrame({"time": TIME, ODD: TIME}).to_parquet(tmp_path / "run.parquet")
    with pytest.raises(BadCalibrationError) as error:
        Calibration(example_fmu("dahlquist"), tmp_path / "run.parquet", ["x"], [K])
    assert_is_shown(str(error.value))
    with pytest.raises(BadCalibrationError) as error:
        Calibration(example_fmu("dahlquist"), pd.DataFrame({"time": TIME, ODD: TIME}), ["x"], [K])
    assert_is_shown(str(error.value))


def test_fits_and_tables_escape_names():
    experiment = Experiment(data(), {"x": ODD}, name="run")
    calibration = Calibration(example_fmu("dahlquist"), [experiment], [Parameter("k", 1.0, 0.1, 1.5, display_name=ODD)])
    fit = calibration.fit()
    assert fit.at_bound
    assert_is_shown(repr(fit), lines=2)
    assert_is_shown(fit._repr_html_(), lines=2)
    for line in repr(fit).splitlines():
        assert not line.startswith(("b", "g"))


def test_warnings_escape_names():
    with pytest.warns(CalibrationWarning) as caught:
        Calibration(example_fmu("dahlquist"), {"time": TIME, f"{ODD} [mm]": np.ones(21)}, {"x": ODD}, [K])
    assert_is_shown(str(caught[0].message))


def test_descriptions_escape_names(tmp_path):
    from xml.sax.saxutils import quoteattr

    # XML cannot contain an escape; a line break and a tabulator are written as references.
    odd = "a\nb\tc\u202ed"
    attribute = quoteattr(odd, {"\n": "&#10;", "\t": "&#9;"})
    variable = f'<ScalarVariable name={attribute} valueReference="1" description={attribute}><Real/></ScalarVariable>'
    description = read_description(fmus.write(tmp_path / "m.fmu", fmus.xml(variable)))
    shown = r"a\u{a}b\u{9}c\u{202e}d"
    assert odd in description.variables
    table = str(description.variables)
    assert shown in table and "\u202e" not in table and "\t" not in table
    text = fmpy.util.fmu_info(str(tmp_path / "m.fmu"), ["local"])
    assert shown[-15:] in text and "\u202e" not in text and "\t" not in text
    with pytest.raises(UnknownVariableError) as error:
        description.variables[odd[:-1]]
    assert shown in str(error.value) and not set(odd) - set("abcd") & set(str(error.value))
