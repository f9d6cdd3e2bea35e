"""Calibrates a diesel exhaust pipe as in Gedda, Andersson, Åkesson and Diehl (2012), section 6.2: first the right gas
volume, then the left.

The model is stiff and has five recorded inputs. The first 500 s of the recording are for the calibration, the rest
for the validation. Both are assessed by the RMS relative to the RMS of the nominal parameters. Then all four
parameters are fitted at once, from the nominal values and from swapped volumes. The fits end at different minima and
report that the data do not determine the parameters separately. The figures of calibration and validation are
exhaust.png and exhaust_validation.png.
"""

from pathlib import Path

import pydfo

RECORDING = Path(__file__).resolve().parent / "data" / "exhaust.csv"
CALIBRATION, VALIDATION = (0, 500), (501, 1200)  # s
LEFT, RIGHT = ["C1", "G1"], ["C2", "G2"]  # heat capacity in J/K and conductance in W/K of each wall
NOMINAL = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
LARGEST = {"C": 5e4, "G": 500.0}
SWAPPED = {"C1": 9000.0, "G1": 80.0, "C2": 2500.0, "G2": 120.0}


def main():
    calibration = pydfo.Calibration(
        pydfo.example_fmu("exhaust"),
        data=RECORDING,
        inputs=["T_in", "p_in", "w_turb1", "w_turb2", "p_out"],
        outputs=["T_out"],
        window=CALIBRATION,
        parameters=[pydfo.Parameter(name, start, 1e-4 * start, LARGEST[name[0]]) for name, start in NOMINAL.items()],
    )

    def show(what, fit):
        """Prints parameters and scaled RMS of a fit; returns its validation."""
        validation = fit.validate(window=VALIDATION)
        values = ", ".join(f"{name} = {value:.1f}" for name, value in fit.parameters.items())
        scaled = fit.rms / nominal, validation.rms / nominal_validation
        print(f"{what}: {values}; scaled RMS {scaled[0]:.3f} in the fit, {scaled[1]:.3f} in the validation")
        return validation

    fit = calibration.fit(stages=[RIGHT, LEFT])
    nominal = fit.start_rms
    nominal_validation = fit.validate(window=VALIDATION).start_rms
    for stage, volume in zip(fit.stages, ("right volume", "then left")):
        validation = show(volume, stage)
    print(f"RMS {nominal:.2f} K nominal, {fit.rms:.2f} K fitted; {fit.nfev} evaluations\n")

    at_once = {}
    for name, start in (("nominal", NOMINAL), ("the result above", fit.parameters), ("swapped volumes", SWAPPED)):
        at_once[name] = calibration.fit(start=start)
        show(f"all four, from {name}", at_once[name])
    sentences = [sentence for one in at_once.values() for sentence in one.uncertainty.verdict if "change the outputs in the same way" in sentence]
    print("\nThree starts, three minima. Findings of the fits:")
    for sentence in dict.fromkeys(sentences):
        print(f"- {sentence}")
    if not sentences:
        raise SystemExit("the four parameters are not identifiable together, but no fit reported it")

    try:
        fit.plot().savefig("exhaust.png", dpi=120)
        validation.plot().savefig("exhaust_validation.png", dpi=120)
    except ImportError as error:  # matplotlib is an extra
        print(error)


if __name__ == "__main__":
    main()
