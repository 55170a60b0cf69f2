"""A run that continues in another process, bit for bit: the state is stored as bytes in a file.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/resume.py
The script calls itself for the second half and passes the file. The bytes belong to this FMU, because they contain its GUID
and a checksum; they do not depend on the computer or the process.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from fivebar import Unit

START = {"init.theta[2]": 2.0944, "friction.enabled": True}
OUTPUTS = ["theta[1]", "theta[2]", "tip.x", "tip.y", "energy.dissipated"]


def second_half(unit: Unit) -> str:
    """Steps to 1 s and returns the outputs with all digits."""
    for _ in range(500):
        unit.step(1e-3)
    return ", ".join(f"{name} = {value!r}" for name, value in zip(OUTPUTS, unit.get(*OUTPUTS)))


if len(sys.argv) == 2:
    with Unit() as unit:
        unit.restore(Path(sys.argv[1]).read_bytes())
        print(second_half(unit))
else:
    with Unit(**START) as unit, tempfile.TemporaryDirectory() as folder:
        unit.step(0.5)
        file = Path(folder) / "state"
        file.write_bytes(unit.state().to_bytes())
        print(f"stored {file.stat().st_size} bytes at {unit.time} s")
        command = [sys.executable, __file__, str(file)]
        other = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
        here = second_half(unit)
    print(f"this process:  {here}")
    print(f"the other one: {other}")
    print("the same bits" if here == other else "not the same")
