"""Initialises a unit with nothing set, or with some values: prints the sentence with which it refuses its start, or nothing.

python -m fivebar.start target/fmu/PickAndPlace.fmu
python -m fivebar.start target/fmu/FiveBar.fmu '{"base.distance": 0.1}'
"""

import argparse
import json
import shutil
from pathlib import Path

import fmpy

from fivebar.slave import Log, instantiate, set_values


def main() -> None:
    """Asks the unit."""
    parser = argparse.ArgumentParser(description="Initialises a unit; prints why it refuses, or nothing.")
    parser.add_argument("fmu", type=Path)
    parser.add_argument("values", type=json.loads, nargs="?", default={}, help="what is set before, as JSON")
    arguments = parser.parse_args()
    directory, log = fmpy.extract(str(arguments.fmu)), Log()
    try:
        model = fmpy.read_model_description(directory, validate=False)
        slave = instantiate(model, directory, log)
        set_values(slave, model, arguments.values)
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.freeInstance()
    except Exception as error:  # FMPy's own where there is no instance
        print(log.last() or error)
    finally:
        shutil.rmtree(directory, ignore_errors=True)


if __name__ == "__main__":
    main()
