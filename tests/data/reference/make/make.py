"""Makes reference trajectories of scenes by two independent programs and keeps the digits on which they agree; README.md explains its use.

python make.py [SCENE ...]
"""

import argparse
import json
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import mpmath

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
MODEL = ROOT / "modelDescription/modelDescription.xml"

# Scenes and durations of their references, in tenths of a second.
SCENES = {
    "fall_90_120": 20,
    "friction_fall": 10,
    "run_down": 10,
    "servo_step": 10,
    "servo_friction": 20,
    "spring_payload": 10,
    "end_stops": 10,
    "bounce": 10,
    "swing": 20,
    "stiff_servo": 5,
    "pick_and_place": 16,
    "pick_up": 16,
    "haptic": 20,
    "flat_table": 30,
    "paper_free_fall": 20,
    "paper_torque_gravity": 25,
    "singular_crossing": 4,  # until before its vertex, at 0.5 s
}

# Steps per millisecond of scenes with sticking friction, which only sticking.c can compute.
STICKING = {
    "friction_fall_stick": 10,
    "run_down_stick": 10,
    "haptic_stick": 20,
    "stick_slip": 40,
}

# Tolerances for local errors of sticking.c: its results with both must agree.
TOLERANCES = ("1e-20", "1e-25")
AGREED = mpmath.mpf("1e-13")

# Local error per step of midpoint.c: the result agrees with the result for 1e-24 to more digits than required.
TOLERANCE = "1e-26"
# Least number of digits on which both programs must agree.
WANTED = mpmath.mpf("1e-15")
COLUMNS = "t,Qx,Qy,th1,th2,th3,th4,w1,w2,w3,w4"


def main() -> int:
    parser = argparse.ArgumentParser(description="Makes reference trajectories.")
    parser.add_argument(
        "scenes", nargs="*", default=[*SCENES, *STICKING], help="scenes of the tables in this file; all of them"
    )
    mpmath.mp.dps = 80  # With 80 digits a signal at its last knot is the nearest double, too.
    with tempfile.TemporaryDirectory() as folder:
        midpoint = Path(folder) / "midpoint"
        sources = [HERE / "midpoint.c", HERE / "machine.c"]
        subprocess.run(["cc", "-O2", "-o", midpoint, *sources, "-lquadmath"], check=True)
        sticking = Path(folder) / "sticking"
        subprocess.run(["cc", "-O2", "-o", sticking, HERE / "sticking.c", "-lquadmath"], check=True)
        for scene in parser.parse_args().scenes:
            if scene in STICKING:
                make_sticking(scene, sticking)
            else:
                make(scene, midpoint)
    return 0


def make(scene: str, midpoint: Path) -> None:
    """Runs both programs on a scene and writes its file."""
    tenths, text = str(SCENES[scene]), scene_text(scene, SCENES[scene])
    first = run([midpoint, tenths, TOLERANCE], text)
    second = run([sys.executable, HERE / "taylor.py", tenths], text)
    digits = agreed_digits(scene, first, second, WANTED)
    how = f"extrapolated midpoint rule (12 or 14 Cartesian coordinates) and Taylor series (4 angles), agree to {digits} digits."
    write(scene, how, first)


def make_sticking(scene: str, sticking: Path) -> None:
    """Runs sticking.c at two tolerances on a scene with sticking friction and writes its file."""
    tenths, text = str(STICKING[scene]), scene_text(scene, STICKING[scene])
    rough, fine = (run([sticking, tenths, tolerance], text) for tolerance in TOLERANCES)
    digits = agreed_digits(scene, rough, fine, AGREED)
    how = f"extrapolated midpoint rule (4 angles, events), at errors per step of {TOLERANCES[0]} and {TOLERANCES[1]}, which agree to {digits} digits."
    write(scene, how, fine)


def scene_text(scene: str, tenths: int) -> str:
    """Input of the programs: values of variables, then the changing inputs for each millisecond."""
    own = own_values(scene)
    signals = own.get("signals", {})
    items = enumeration_items()
    values = start_values() | {
        name: items[name][value] if name in items else value for name, value in own.items() if name != "signals"
    }
    lines = [*values.items(), ("signals", len(signals))]
    for point in range(100 * tenths if signals else 0):
        lines += [(name, signal_at(signals, name, mpmath.mpf(point) / 1000)) for name in signals]
    return "".join(f"{name} {float(value).hex()}\n" for name, value in lines)


def agreed_digits(scene: str, first: list, second: list, wanted: mpmath.mpf) -> int:
    """The number of digits on which all rows agree; refuses too few."""
    difference = max(
        abs(a - b) / (1 + abs(a)) for x, y in zip(first, second, strict=True) for a, b in zip(x, y, strict=True)
    )
    print(f"{scene}: largest difference {mpmath.nstr(difference, 2)} of 1 + |value|", flush=True)
    if not difference < wanted:
        raise SystemExit(
            f"{scene}: two runs differ by {mpmath.nstr(difference, 2)}, and {mpmath.nstr(wanted, 2)} is wanted."
        )
    return int(-mpmath.log10(difference))


def write(scene: str, how: str, rows: list) -> None:
    """Writes the file of a scene: a head with its origin and the scene's values, then the rows."""
    own = own_values(scene)
    head = [
        f"scene {scene}, set below, everything else as in modelDescription.xml; each number is the double nearest to what is written.",
        f"Quadruple precision: {how}",
        *(
            ["Mass at rest joins in an inelastic impact, mass that leaves goes on with the tip."]
            if "payload.mass" in own.get("signals", {})
            else []
        ),
        *(
            ["Inputs that change are held for 1 ms: the double nearest to the signal where each begins."]
            if "signals" in own
            else []
        ),
        "th: absolute link angles, ccw from +x: 1 left proximal, 2 left distal (elbow to Q), 3 right distal, 4 right proximal; w: rates. SI units.",
        *(f"{name} = {json.dumps(value)}" for name, value in own.items()),
    ]
    text = [",".join([mpmath.nstr(row[0], 3), *(mpmath.nstr(x, 24) for x in row[1:])]) for row in rows]
    lines = [*(f"# {line}" for line in head), COLUMNS, *text]
    (HERE.parent / f"{scene}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def start_values() -> dict[str, float]:
    """Parameters and inputs with their start values, from the model description."""
    values = {}
    for variable in ET.parse(MODEL).iter("ScalarVariable"):
        if variable.get("causality") in ("parameter", "input"):
            start = variable[0].get("start")
            values[variable.get("name")] = float({"true": 1, "false": 0}.get(start, start))
    return values


def enumeration_items() -> dict[str, dict[str, int]]:
    """For every enumeration variable: values of its items by name."""
    model = ET.parse(MODEL)
    types = {
        kind.get("name"): {item.get("name"): int(item.get("value")) for item in kind.iter("Item")}
        for kind in model.iter("SimpleType")
    }
    used = {variable.get("name"): variable[0].get("declaredType") for variable in model.iter("ScalarVariable")}
    return {name: types[kind] for name, kind in used.items() if types.get(kind)}


def own_values(scene: str) -> dict[str, float | bool | str | dict]:
    """Values and signals of the scene, without solver settings; enumerations by the names of their items."""
    content = json.loads((ROOT / f"scenes/{scene}.json").read_text(encoding="utf-8"))
    known = {"signals", *start_values()}
    own = {name: value for name, value in content.items() if name in known and not name.startswith("solver.")}
    items = enumeration_items()
    for name, value in own.items():
        if value not in items.get(name, ()) and name != "signals" and not isinstance(value, (bool, int, float)):
            raise SystemExit(
                f"{scene}: {name} is neither a constant nor the signals; only such scenes can have a reference."
            )
    if "signals" in own and content["experiment"]["stepSize"] != 0.001:
        raise SystemExit(f"{scene}: stepSize is not 0.001; inputs that change are held for 1 ms.")
    return own


def signal_at(signals: dict[str, dict], name: str, time: mpmath.mpf) -> mpmath.mpf:
    """The value of a signal, as in scenes/src/signal.rs, at a time in s."""
    ((kind, value),) = signals[name].items()
    rate = kind == "rateOf"
    if rate:
        ((kind, value),) = signals[value].items()
    if kind == "steps":  # a nanosecond early, as in scenes/src/signal.rs
        return next(
            (mpmath.mpf(knot[1]) for knot in reversed(value) if knot[0] - 1e-9 <= time), mpmath.mpf(value[0][1])
        )
    shape = {"linear": [0, 1], "minimumJerk": [0, 0, 0, 10, -15, 6]}[kind]  # a polynomial in u, rising powers
    knots = [tuple(map(mpmath.mpf, knot)) for knot in value]
    if not knots[0][0] <= time < knots[-1][0]:
        return mpmath.mpf(0) if rate else knots[0][1] if time < knots[0][0] else knots[-1][1]
    (begin, before), (end, after) = next(pair for pair in pairwise(knots) if pair[0][0] <= time < pair[1][0])
    u = (time - begin) / (end - begin)
    if rate:
        return (after - before) / (end - begin) * sum(i * c * u ** (i - 1) for i, c in enumerate(shape) if i > 0)
    return before + (after - before) * sum(c * u**i for i, c in enumerate(shape))


def run(command: list, text: str) -> list[list[mpmath.mpf]]:
    """Runs a program on a scene and returns its rows."""
    printed = subprocess.run(list(map(str, command)), input=text, text=True, stdout=subprocess.PIPE, check=True).stdout
    rows = [[mpmath.mpf(x) for x in line.split(",")] for line in printed.splitlines()]
    if not all(mpmath.isfinite(x) for row in rows for x in row):
        raise SystemExit(f"{command[0]} printed a value that is not finite.")
    return rows


if __name__ == "__main__":
    sys.exit(main())
