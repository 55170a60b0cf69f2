"""Initialises a unit with nothing set: prints the sentence with which it refuses its start, or nothing.

python start.py target/fmu/PickAndPlace.fmu
"""

import argparse
import shutil
from pathlib import Path

import fmpy

from slave import Log, instantiate


def main() -> None:
    """Asks the unit."""
    parser = argparse.ArgumentParser(description="Initialises a unit with nothing set; prints why it refuses, or nothing.")
    parser.add_argument("fmu", type=Path)
    fmu = parser.parse_args().fmu
    directory, log = fmpy.extract(str(fmu)), Log()
    try:
        slave = instantiate(fmpy.read_model_description(directory, validate=False), directory, log)
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
