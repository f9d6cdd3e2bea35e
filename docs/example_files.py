"""Puts the models and recordings that the guides use into a folder.

    python docs/example_files.py FOLDER

The models are the bundled ones; the recordings are those of examples/data, whose readme says how they were made.
"""

import shutil
import sys
from pathlib import Path

import pydfo

RECORDINGS = Path(__file__).resolve().parent.parent / "examples" / "data"
MODELS = ("furuta", "quad_tank", "exhaust", "dahlquist", "bouncing_ball", "van_der_pol")


def write(folder):
    """The files; the folder is made where it is not there."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in MODELS:
        shutil.copyfile(pydfo.example_fmu(name), folder / f"{name}.fmu")
    for recording in RECORDINGS.glob("*.csv"):
        shutil.copyfile(recording, folder / recording.name)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    write(sys.argv[1])
