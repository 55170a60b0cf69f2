"""Initialises a unit with nothing set: prints the sentence with which it refuses its start, or nothing.

python start.py target/fmu/PickAndPlace.fmu
"""

import argparse
import shutil
from pathlib import Path

import fmpy
from fmpy.fmi1 import FMICallException

from slave import Log, instantiate


def main() -> None:
    """Asks the unit."""
    parser = argparse.ArgumentParser(description="Initialises a unit with nothing set; prints why it refuses, or nothing.")
    parser.add_argument("fmu", type=Path)
    fmu = parser.parse_args().fmu
    directory = fmpy.extract(str(fmu))
    try:
        log = Log()
        slave = instantiate(fmpy.read_model_description(directory, validate=False), directory, log)
        try:
            slave.setupExperiment()
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        except FMICallException as error:
            print(log.last() or error)
        slave.freeInstance()
    finally:
        shutil.rmtree(directory, ignore_errors=True)


if __name__ == "__main__":
    main()
