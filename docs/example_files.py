"""Writes the models, recordings and set-ups that the guides use to a folder.

    python docs/example_files.py FOLDER

The models are bundled with pydfo. The recordings come from examples/data; the readme there explains how they were made.
The set-ups are the Python files in docs/setups: each creates a calibration that several guides use.
"""

import shutil
import sys
from pathlib import Path

import pydfo

HERE = Path(__file__).resolve().parent
RECORDINGS = HERE.parent / "examples" / "data"
MODELS = ("furuta", "quad_tank", "exhaust", "dahlquist", "bouncing_ball", "van_der_pol", "tank_control")


def write(folder):
    """Writes the files; creates the folder if it does not exist."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in MODELS:
        shutil.copyfile(pydfo.example_fmu(name), folder / f"{name}.fmu")
    for recording in RECORDINGS.glob("*.csv"):
        shutil.copyfile(recording, folder / recording.name)
    for setup in (HERE / "setups").glob("*.py"):
        shutil.copyfile(setup, folder / setup.name)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    write(sys.argv[1])
    print(f"wrote {len(list(Path(sys.argv[1]).iterdir()))} files to {sys.argv[1]}")
