"""FMUs of a few lines of C, for benches: FMI 2.0 Model Exchange, without directional derivatives.

    path = build("spring_pendulum", folder)

Needs a C compiler and the FMI headers of crates/fmi/headers.
"""

import platform
import subprocess
import sys
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

HEADERS = Path(__file__).resolve().parents[1] / "crates" / "fmi" / "headers"


@dataclass
class Model:
    """States and parameters with start values; C statements that read and write `x`, `dx`, `p`, `z` and `mode`."""

    states: dict[str, float]
    parameters: dict[str, float]
    derivatives: str
    indicators: str = ""
    n_indicators: int = 0
    #: Sets `mode` (initially 0) from `x` and `p`; run at initialisation and at each event.
    event: str = ""
    stop: float = 10.0
    nominals: dict[str, float] = field(default_factory=dict)


MODELS = {
    # A mass on a spring that swings in a plane: radius, angle and their rates.
    "spring_pendulum": Model(
        states={"r": 1.2, "phi": 0.5, "vr": 0.0, "w": 0.0},
        parameters={"k": 40.0, "m": 1.0, "l0": 1.0, "d": 0.1},
        derivatives="""
            dx[0] = x[2]; dx[1] = x[3];
            dx[2] = x[0] * x[3] * x[3] + 9.81 * cos(x[1]) - p[0] / p[1] * (x[0] - p[2]) - p[3] * x[2];
            dx[3] = (-9.81 * sin(x[1]) - 2.0 * x[2] * x[3]) / x[0];""",
    ),
    # A pendulum with dry friction at its joint: it slips in either direction, or sticks (mode 0).
    "friction_pendulum": Model(
        states={"phi": 1.5, "w": 0.0},
        parameters={"g_l": 9.81, "mu": 0.3, "c": 0.05},
        derivatives="dx[0] = x[1]; dx[1] = mode == 0 ? 0.0 : -p[0] * sin(x[0]) - p[1] * mode - p[2] * x[1];",
        indicators="z[0] = mode == 0 ? 1.0 : mode * x[1]; z[1] = mode == 0 ? p[1] - fabs(p[0] * sin(x[0])) : 1.0;",
        n_indicators=2,
        event="""
            if (mode == 0 || mode * x[1] <= 0.0) {
                x[1] = 0.0;
                mode = fabs(p[0] * sin(x[0])) <= p[1] ? 0 : (sin(x[0]) > 0.0 ? -1 : 1);
            }""",
    ),
    # Two decays whose right-hand side waits 0.2 ms, like an expensive model.
    "slow_decay": Model(
        states={"a": 1.0, "b": 0.5},
        parameters={"k1": 1.0, "k2": 0.3},
        derivatives="extern int usleep(unsigned); usleep(200); dx[0] = -p[0] * x[0]; dx[1] = p[0] * x[0] - p[1] * x[1];",
        stop=4.0,
    ),
    # Robertson's reactions: stiff.
    "robertson": Model(
        states={"A": 1.0, "B": 0.0, "C": 0.0},
        parameters={"k1": 0.04, "k2": 3e7, "k3": 1e4},
        derivatives="""
            const double r1 = p[0] * x[0], r2 = p[1] * x[1] * x[1], r3 = p[2] * x[1] * x[2];
            dx[0] = r3 - r1; dx[1] = r1 - r2 - r3; dx[2] = r2;""",
        stop=1000.0,
        nominals={"B": 1e-5},
    ),
    # Two species.
    "lotka_volterra": Model(
        states={"prey": 10.0, "predators": 5.0},
        parameters={"a": 1.1, "b": 0.4, "c": 0.1, "d": 0.4},
        derivatives="dx[0] = p[0] * x[0] - p[1] * x[0] * x[1]; dx[1] = p[2] * x[0] * x[1] - p[3] * x[1];",
        stop=30.0,
    ),
    # Absorption and elimination of a dose.
    "one_compartment": Model(
        states={"gut": 100.0, "blood": 0.0},
        parameters={"ka": 1.0, "ke": 0.2, "V": 20.0},
        derivatives="dx[0] = -p[0] * x[0]; dx[1] = p[0] * x[0] / p[2] - p[1] * x[1];",
        stop=24.0,
    ),
}

SOURCE = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"
#define NX %(nx)d
#define NP %(np)d
#define NZ %(nz)d
typedef struct { double x[NX], dx[NX], p[NP], start[NX], t; int mode; } Memory;
static const double STARTS[NX] = {%(starts)s}, VALUES[NP] = {%(values)s};
static void put_back(Memory *m) {
    memcpy(m->start, STARTS, sizeof STARTS); memcpy(m->x, STARTS, sizeof STARTS); memcpy(m->p, VALUES, sizeof VALUES);
    m->t = 0.0; m->mode = 0;
}
static void calculate(Memory *m) {
    double *x = m->x, *dx = m->dx, *p = m->p; int mode = m->mode; (void)x; (void)p; (void)mode;
    %(derivatives)s
}
static void settle(Memory *m) {
    double *x = m->x, *p = m->p; int mode = m->mode; (void)x; (void)p;
    %(event)s
    m->mode = mode;
}
static double *at(Memory *m, fmi2ValueReference r) { return r < NX ? m->x + r : r < 2 * NX ? m->dx + (r - NX) : m->p + (r - 2 * NX); }
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String s[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f, fmi2Boolean v, fmi2Boolean l) {
    Memory *m = calloc(1, sizeof *m); if (m) put_back(m); return m; }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real tol, fmi2Real start, fmi2Boolean s, fmi2Real stop) {
    ((Memory *)c)->t = start; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { settle(c); return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { put_back(c); return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    calculate(c); for (size_t i = 0; i < n; i++) v[i] = *at(c, r[i]); return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) *at(c, r[i]) = v[i]; return fmi2OK; }
#define NONE(K, T) \
    fmi2Status fmi2Get##K(fmi2Component c, const fmi2ValueReference r[], size_t n, T v[]) { return n ? fmi2Error : fmi2OK; } \
    fmi2Status fmi2Set##K(fmi2Component c, const fmi2ValueReference r[], size_t n, const T v[]) { return n ? fmi2Error : fmi2OK; }
NONE(Integer, fmi2Integer)
NONE(Boolean, fmi2Boolean)
NONE(String, fmi2String)
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) {
    if (!*s) *s = malloc(sizeof(Memory)); memcpy(*s, c, sizeof(Memory)); return fmi2OK; }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { memcpy(c, s, sizeof(Memory)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { free(*s); *s = NULL; return fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) { return fmi2Error; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) { return fmi2Error; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) { return fmi2Error; }
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu, const fmi2ValueReference k[], size_t nk,
    const fmi2Real d[], fmi2Real v[]) { return fmi2Error; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *e) {
    Memory old = *(Memory *)c; settle(c); memset(e, 0, sizeof *e);
    e->valuesOfContinuousStatesChanged = memcmp(old.x, ((Memory *)c)->x, sizeof old.x) != 0; return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean f, fmi2Boolean *e, fmi2Boolean *t) { *e = *t = fmi2False; return fmi2OK; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { ((Memory *)c)->t = t; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { memcpy(((Memory *)c)->x, x, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { memcpy(x, ((Memory *)c)->x, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    static const double nominals[NX] = {%(nominals)s}; memcpy(x, nominals, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) { calculate(c); memcpy(d, ((Memory *)c)->dx, n * sizeof *d); return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    Memory *m = c; double *x = m->x, *p = m->p; int mode = m->mode; (void)x; (void)p; (void)mode; (void)z;
    %(indicators)s
    return fmi2OK; }
"""


def description(name: str, model: Model) -> str:
    """Returns the model description."""
    lines, n = [], len(model.states)
    for k, (state, start) in enumerate(model.states.items()):
        nominal = f' nominal="{model.nominals[state]!r}"' if state in model.nominals else ""
        lines.append(
            f'<ScalarVariable name="{state}" valueReference="{k}" causality="output" initial="exact">'
            f'<Real start="{start!r}"{nominal}/></ScalarVariable>'
        )
    for k, state in enumerate(model.states):
        lines.append(f'<ScalarVariable name="der({state})" valueReference="{n + k}"><Real derivative="{k + 1}"/></ScalarVariable>')
    for k, (parameter, start) in enumerate(model.parameters.items()):
        lines.append(
            f'<ScalarVariable name="{parameter}" valueReference="{2 * n + k}" causality="parameter" variability="fixed">'
            f'<Real start="{start!r}"/></ScalarVariable>'
        )
    unknowns = lambda first: "".join(f'<Unknown index="{first + k}"/>' for k in range(n))  # noqa: E731
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{{{name}}}" '
        f'numberOfEventIndicators="{model.n_indicators}">\n<ModelExchange modelIdentifier="{name}" canGetAndSetFMUstate="true"/>\n'
        f'<DefaultExperiment startTime="0" stopTime="{model.stop!r}"/>\n<ModelVariables>\n' + "\n".join(lines) + "\n</ModelVariables>\n"
        f"<ModelStructure><Outputs>{unknowns(1)}</Outputs><Derivatives>{unknowns(n + 1)}</Derivatives>"
        f"<InitialUnknowns>{unknowns(n + 1)}</InitialUnknowns></ModelStructure>\n</fmiModelDescription>\n"
    )


def build(name: str, folder: Path) -> Path:
    """Compiles a model and packs its FMU into a folder."""
    model = MODELS[name]
    numbers = lambda values: ", ".join(map(repr, values))  # noqa: E731
    source = folder / f"{name}.c"
    source.write_text(
        SOURCE
        % {
            "nx": len(model.states),
            "np": len(model.parameters),
            "nz": model.n_indicators,
            "starts": numbers(model.states.values()),
            "values": numbers(model.parameters.values()),
            "nominals": numbers(model.nominals.get(state, 1.0) for state in model.states),
            "derivatives": model.derivatives,
            "indicators": model.indicators,
            "event": model.event,
        }
    )
    system = {"Linux": ("linux64", ".so"), "Darwin": ("darwin64", ".dylib"), "Windows": ("win64", ".dll")}[platform.system()]
    library = folder / f"{name}{system[1]}"
    headers = next(HEADERS.rglob("fmi2Functions.h")).parent
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-w", "-I", headers, "-o", library, source, "-lm"], check=True)
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description(name, model))
        archive.write(library, f"binaries/{system[0]}/{library.name}")
    return path


if __name__ == "__main__":
    print(build(sys.argv[1], Path(sys.argv[2] if len(sys.argv) > 2 else ".")))
