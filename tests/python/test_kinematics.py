"""fivebar.kinematics against the unit, against independently computed numbers, and against itself."""

import json
import tomllib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from conftest import REPOSITORY
from fivebar.errors import FiveBarError
from fivebar.kinematics import GEOMETRY, LEAST_SINE, WORKING_MODES, Machine, Posture, Working, sines
from instance import Instance

OUT: Working = ("minus", "plus")
ALIKE: Working = ("plus", "plus")


def machine(distance: float, proximal: float, distal: float) -> Machine:
    """A symmetric machine."""
    return Machine(distance, (proximal, distal, distal, proximal))


PAPER = machine(0.42, 0.21, 0.21)
HAPTIC = machine(0.10, 0.21, 0.21)
DEXTAR = machine(0.118, 0.09, 0.09)
PANTOGRAPH = machine(0.025, 0.063, 0.075)


class Sample(NamedTuple):
    """Random postures of a machine: motor angles and rates, and which assembly."""

    machine: Machine
    theta: np.ndarray
    omega: np.ndarray
    assembly: str


def samples(machines: int, postures: int, seed: int = 40) -> list[Sample]:
    """Machines with random lengths, every tenth coaxial, every fifth symmetric, in postures with a closed loop."""
    random = np.random.default_rng(seed)
    found: list[Sample] = []
    while len(found) < machines:
        lengths = random.uniform(0.05, 0.4, 4)
        if len(found) % 5 == 0:
            lengths[2:] = lengths[1::-1]
        made = Machine(0.0 if len(found) % 10 == 3 else random.uniform(0.02, 0.6), tuple(lengths.tolist()))
        theta = random.uniform(-np.pi, np.pi, (40 * postures, 2))
        elbows = [
            made.lengths[i] * np.exp(1j * theta[:, j]) + foot for i, j, foot in ((0, 0, 0.0), (3, 1, made.distance))
        ]
        apart = np.abs(elbows[1] - elbows[0])
        theta = theta[
            (apart < 0.9999 * (lengths[1] + lengths[2])) & (apart > 1.0001 * abs(lengths[1] - lengths[2]) + 1e-4)
        ]
        if len(theta) >= postures:
            omega = random.uniform(-5, 5, (postures, 2))
            found.append(Sample(made, theta[:postures], omega, ("plus", "minus")[len(found) % 2]))
    return found


READ = (
    "tip.x",
    "tip.y",
    "tip.vx",
    "tip.vy",
    "passive.theta[1]",
    "passive.theta[2]",
    "passive.omega[1]",
    "passive.omega[2]",
)
READ += (
    "elbow[1].x",
    "elbow[1].y",
    "elbow[2].x",
    "elbow[2].y",
    "singular.detJx",
    "singular.detJq",
    "singular.sigmaJx",
    "singular.sigmaJq",
)


def read_from_unit(instance: Instance, sample: Sample) -> tuple[dict[str, np.ndarray], list[tuple[int, int, int]]]:
    """The unit's values at the start of each posture, and its enumerations: assembly, working mode, kind of singularity."""
    slave, references = instance.slave, {v.name: v.valueReference for v in instance.model.modelVariables}
    names = [*GEOMETRY, "init.theta[1]", "init.theta[2]", "init.omega[1]", "init.omega[2]"]
    values, kinds = [], []
    for theta, omega in zip(sample.theta, sample.omega):
        slave.reset()
        slave.setReal(
            [references[name] for name in names], [sample.machine.distance, *sample.machine.lengths, *theta, *omega]
        )
        slave.setInteger([references["init.assembly"]], [1 if sample.assembly == "plus" else 2])
        slave.setupExperiment()
        slave.enterInitializationMode()
        values.append(slave.getReal([references[name] for name in READ]))
        kinds.append(
            tuple(slave.getInteger([references[name] for name in ("mode.assembly", "mode.working", "singular.type")]))
        )
    columns = dict(zip(READ, np.array(values).T))
    return columns, kinds


def pair(columns: dict[str, np.ndarray], first: str, second: str) -> np.ndarray:
    """Two columns as vectors."""
    return np.stack([columns[first], columns[second]], axis=-1)


def test_the_unit_agrees(new: Callable[..., Instance]) -> None:
    """In 10,000 postures of 200 machines positions agree to 1e-12 m both ways, and angles, rates and the Jacobian within their conditioning."""
    instance = new()
    for sample in samples(200, 50):
        made = sample.machine
        unit, kinds = read_from_unit(instance, sample)
        tip, passive = pair(unit, "tip.x", "tip.y"), pair(unit, "passive.theta[1]", "passive.theta[2]")
        posture = made.forward(sample.theta, sample.assembly)
        assert np.abs(posture.tip - tip).max() < 1e-12
        assert np.abs(posture.elbows[:, 0] - pair(unit, "elbow[1].x", "elbow[1].y")).max() < 1e-12
        assert np.abs(posture.elbows[:, 1] - pair(unit, "elbow[2].x", "elbow[2].y")).max() < 1e-12
        sine = np.abs(sines(posture.theta))
        assert (turned(posture.theta[:, 1:3], passive) * sine[:, :1]).max() < 1e-12

        bends = [("plusPlus", "plusMinus", "minusPlus", "minusMinus")[mode - 1] for _, mode, _ in kinds]
        assert bends == [left + right.capitalize() for left, right in posture.working]
        assert (
            [("plus", "minus")[side - 1] for side, _, _ in kinds]
            == posture.assembly.tolist()
            == [sample.assembly] * len(tip)
        )
        ours = made.singularity(posture.theta)
        theirs = np.array([("none", "direct", "inverse", "combined", "combined")[kind - 1] for _, _, kind in kinds])
        constraint = np.array([kind == 5 for _, _, kind in kinds])
        assert np.all((ours == theirs) | constraint)

        for working in WORKING_MODES:
            rows = np.all(posture.working == np.array(working), axis=-1)
            if rows.any():
                back = made.inverse(tip[rows], working, sample.assembly)
                again = made.forward(back.motors, sample.assembly)
                # Near a direct singularity the round-off of the motor angles is amplified.
                assert (np.abs(again.tip - tip[rows]) * sine[rows, :1]).max() < 1e-12
                assert np.abs(elbow_to_tip(made, back) - np.array(made.lengths[1:3])).max() < 1e-12
                assert (turned(back.motors, sample.theta[rows]) * sine[rows][:, 1:]).max() < 1e-11

        j_x, j_q = made.loop_jacobians(posture.theta)
        assert np.abs(np.linalg.det(j_x) - unit["singular.detJx"]).max() < 1e-12
        assert np.abs(np.linalg.det(j_q) - unit["singular.detJq"]).max() < 1e-12
        assert np.abs(np.linalg.svd(j_q, compute_uv=False)[:, 1] - unit["singular.sigmaJq"]).max() < 1e-12
        assert np.abs(np.linalg.svd(j_x, compute_uv=False)[:, 1] - unit["singular.sigmaJx"]).max() < 1e-12

        velocity, rates = pair(unit, "tip.vx", "tip.vy"), pair(unit, "passive.omega[1]", "passive.omega[2]")
        weight = sine[:, :1] ** 2 / np.abs(sample.omega).max()
        assert (np.abs(made.tip_velocity(posture.theta, sample.omega) - velocity) * weight).max() < 1e-12
        links = made.link_rates(posture.theta, sample.omega)
        assert (np.abs(links[:, 1:3] - rates) * weight).max() < 2e-11
        assert np.array_equal(links[:, [0, 3]], sample.omega)


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Difference of two angles modulo whole turns."""
    return np.abs(np.remainder(a - b + np.pi, 2 * np.pi) - np.pi)


def elbow_to_tip(made: Machine, posture: Posture) -> np.ndarray:
    """Distances of the tip from both elbows: the lengths of the distal links."""
    elbows = [made.lengths[i] * np.exp(1j * posture.theta[..., i]) + foot for i, foot in ((0, 0.0), (3, made.distance))]
    tip = posture.tip[..., 0] + 1j * posture.tip[..., 1]
    return np.abs(np.stack([tip - elbow for elbow in elbows], axis=-1))


def test_the_version_is_that_of_the_workspace() -> None:
    cargo = tomllib.loads((REPOSITORY / "Cargo.toml").read_text(encoding="utf-8"))
    assert version("fivebar") == cargo["workspace"]["package"]["version"]


# Independently computed numbers, m and rad


@pytest.mark.parametrize(
    ("made", "tip", "working", "theta", "kappa"),
    [
        (PAPER, (0.21, 0.30), OUT, (1.471804090732, 0.448336634080, 2.693256019510, 1.669788562858), 2.078980),
        (PAPER, (0.21, 0.30), ALIKE, (0.448336634080, 1.471804090732, 2.693256019510, 1.669788562858), 10 / 7),
        (
            PAPER,
            (0.16, 0.29),
            OUT,
            (1.728905917935, 0.404354812697, 2.685232711969, 1.918173355935),
            0.304156455 / 0.128696234,
        ),
        (HAPTIC, (0.05, 0.25), OUT, (2.291884086801, None, None, 0.849708566788), 2.044428),
        (HAPTIC, (0.05, 0.25), ALIKE, (None, None, None, None), 5.0),
        (PAPER, (0.21, 0.349282907142), OUT, (1.273544965474, np.pi / 4, None, None), 1.0),
        (DEXTAR, (0.059, 0.153519942), OUT, (None, None, None, None), 1.0),
        (DEXTAR, (0.059, 0.12), OUT, (1.847259468736, 0.380415693760, None, None), 2.500658),
        (DEXTAR, (0.059, 0.12), ALIKE, (None, None, None, None), 120 / 59),
        (PANTOGRAPH, (0.0125, 0.10), OUT, (2.283818645375, 0.772554831910, None, None), 1.026022),
        (PANTOGRAPH, (0.0125, 0.10), ALIKE, (None, None, None, None), 8.0),
    ],
)
def test_known_postures(
    made: Machine, tip: tuple[float, float], working: Working, theta: tuple[float | None, ...], kappa: float
) -> None:
    posture = made.inverse(tip, working, assembly="plus")
    for found, expected in zip(posture.theta, theta):
        assert expected is None or found == pytest.approx(expected, abs=1e-11)
    assert made.condition(posture.theta) == pytest.approx(kappa, abs=1e-6)
    assert made.dexterity(posture.theta) == pytest.approx(1 / kappa, abs=1e-6)


def test_known_sines_and_singular_values() -> None:
    assert sines(PAPER.inverse((0.21, 0.30), OUT).theta)[0] == pytest.approx(0.781254649, abs=1e-9)
    assert sines(PAPER.inverse((0.21, 0.30), ALIKE).theta)[0] == pytest.approx(0.126 / 0.1341, abs=1e-12)
    assert HAPTIC.inverse((0.05, 0.25), ("plus", "minus")).assembly == "minus"
    for made, tip, axes in (
        (PAPER, (0.16, 0.29), (0.304156455, 0.128696234)),
        (PAPER, (0.21, 0.349282907142), (0.098487890, 0.098487890)),
        (DEXTAR, (0.059, 0.153519942), (0.06683569, 0.06683569)),
    ):
        assert made.velocity_ellipse(made.inverse(tip, OUT).theta).axes == pytest.approx(axes, abs=1e-8)


def test_known_reach() -> None:
    assert PAPER.reach_area == pytest.approx(0.216684415, abs=1e-9)
    assert DEXTAR.reach_area == pytest.approx(0.060081020, abs=1e-9)
    for made, x, top in ((PAPER, 0.21, 0.363730670), (DEXTAR, 0.059, 0.170055873)):
        assert made.is_reachable([(x, top - 1e-8), (x, top + 1e-8)]).tolist() == [True, False]


def test_known_direct_singularities() -> None:
    for made, theta4, tips in (
        (
            DEXTAR,
            (-2.264434151713, 1.295283994041),
            ((0.011503154360, 0.006316745435), (0.052515191602, 0.084221251909)),
        ),
        (PAPER, (-2.719893320797, 2.0), ((0.070503138499, 0.052498521735), (0.122609164325, 0.190952459633))),
    ):
        found = made.direct_at(2.0)
        assert [kind for kind, _ in found] == ["stretched", "stretched"]
        assert [turned(posture.theta[3], angle) < 1e-11 for (_, posture), angle in zip(found, theta4)] == [True, True]
        assert np.stack([posture.tip for _, posture in found]) == pytest.approx(np.array(tips), abs=1e-11)
    assert PANTOGRAPH.direct_at(2.5) == []


def test_direct_singularity_on_the_axis() -> None:
    """With elbows inwards the distal links lie along the x axis; the working mode with elbows outwards has its locus there."""
    y = np.sqrt(0.09**2 - (0.059 - 0.09) ** 2)
    assert y == pytest.approx(0.084492603227, abs=1e-12)
    assert np.abs(sines(DEXTAR.inverse((0.059, y), OUT).theta)[0]) < 1e-7
    above, below = DEXTAR.inverse([(0.059, y + 1e-6), (0.059, y - 1e-6)], OUT).assembly
    assert (above, below) == ("plus", "minus")


@pytest.mark.parametrize("made", [PAPER, HAPTIC, DEXTAR, PANTOGRAPH, machine(0.3, 0.2, 0.25)])
def test_stretched_distal_links_are_on_the_curve_of_watt(made: Machine) -> None:
    """In polar coordinates about the middle of the base the curve is r^2 = l_P^2 - (a sin f +- sqrt(l_D^2 - a^2 cos^2 f))^2."""
    half, (proximal, distal) = made.distance / 2, made.legs[0]
    for locus in made.direct_singularities():
        if locus.posture == "stretched":
            x, y = locus.tip[:, 0] - half, locus.tip[:, 1]
            squared = x**2 + y**2
            # Multiplied by r^2, because the curve may pass through r = 0.
            root = np.sqrt(np.maximum(distal**2 * squared - (half * x) ** 2, 0))
            residual = np.minimum(
                *(np.abs((proximal**2 - squared) * squared - (half * y + side * root) ** 2) for side in (-1, 1))
            )
            assert residual.max() < 1e-15


@pytest.mark.parametrize(
    "made", [sample.machine for sample in samples(40, 5, seed=7)] + [PAPER, HAPTIC, DEXTAR, PANTOGRAPH]
)
def test_direct_loci_are_whole(made: Machine) -> None:
    """Loci are closed and singular, links have their lengths, and each random path that changes its assembly crosses a locus."""
    loci = made.direct_singularities(20_000)
    for locus in loci:
        assert np.abs(sines(locus.theta)[:, 0]).max() < 1e-12
        assert np.abs(locus.tip[0] - locus.tip[-1]).max() < 1e-12
        posture = Posture(locus.theta, locus.tip, np.zeros((len(locus.tip), 2, 2)))
        assert np.abs(elbow_to_tip(made, posture) - np.array(made.lengths[1:3])).max() < 1e-12
    tips = np.concatenate([locus.tip for locus in loci]) if loci else np.zeros((0, 2))
    random = np.random.default_rng(3)
    crossings = 0
    for working in WORKING_MODES:
        if made.is_degenerate(working):
            continue
        for _ in range(20):
            far = made.reach[:, 1].min()
            begin, end = (random.uniform((-far, -far), (made.distance + far, far)) for _ in range(2))
            line = begin + np.linspace(0, 1, 2001)[:, None] * (end - begin)
            posture, reached = made.field(line, working)
            signs = np.sign(sines(posture.theta)[:, 0])
            for i in np.flatnonzero((signs[1:] != signs[:-1]) & reached[1:] & reached[:-1]):
                crossings += 1
                assert np.hypot(*(tips - line[i]).T).min() < 2e-3
    assert crossings > 0 or made.distance == 0 or not loci or made.reach_area < 0.02


@pytest.mark.parametrize(
    "more", [sign * more for more in (5.6e-17, 1e-15, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3) for sign in (1, -1)]
)
@pytest.mark.parametrize(("distance", "proximal"), [(0.1, (0.21, 0.21)), (0.25, (0.2, 0.17)), (0.3, (0.17, 0.2))])
def test_loci_of_distal_links_of_almost_equal_length(
    distance: float, proximal: tuple[float, float], more: float
) -> None:
    """Links have their lengths to round-off; folded loci deviate from the loci for equal lengths in proportion to the difference."""
    alike, made = (Machine(distance, (proximal[0], 0.3 + by, 0.3, proximal[1])) for by in (0.0, more))
    loci = [[locus for locus in each.direct_singularities(4001) if locus.posture == "folded"] for each in (alike, made)]
    assert len(loci[0]) == len(loci[1]) == 2
    for locus in loci[1]:
        assert np.abs(sines(locus.theta)[:, 0]).max() < 1e-12
        posture = Posture(locus.theta, locus.tip, np.zeros((len(locus.tip), 2, 2)))
        assert np.abs(elbow_to_tip(made, posture) - np.array(made.lengths[1:3])).max() < 1e-15 * made.size
        # An elbow moves by the difference over the sine of the angle between the proximal links, at least 0.44 here; points are 5e-4 m apart.
        chords = np.concatenate([each.tip for each in loci[0]])
        nearest = np.hypot(*(locus.tip[::40, None] - chords).transpose(2, 0, 1)).min(axis=-1)
        assert nearest.max() < 4 * abs(more) + 5e-4 / 2
        # With the tip there and legs bent as on the locus, the distal links are in line, up to the rotation by 1e-15 m of the tip.
        for row in range(0, len(locus.tip), 200):
            bends = np.sign(sines(locus.theta[row])[1:])
            if np.abs(sines(locus.theta[row])[1:]).min() > 0.1:
                names = ["plus" if bend > 0 else "minus" for bend in bends]
                assert abs(sines(made.inverse(locus.tip[row], (names[0], names[1])).theta)[0]) < 1e-13


@pytest.mark.parametrize("more", [1e-12, 1e-9, 1e-5, 1e-2])
def test_loci_at_an_angle_of_the_motor(more: float) -> None:
    """The distance of the elbows is the difference of the lengths, to round-off over the sine of the right leg's angle."""
    made = Machine(0.1, (0.21, 0.3 + more, 0.3, 0.21))
    # Both elbows at one point, and slightly further.
    theta1 = np.arccos(0.05 / 0.21) + more
    found = [posture for kind, posture in made.direct_at(float(theta1)) if kind == "folded"]
    assert len(found) == 2
    for posture in found:
        assert np.hypot(*(posture.elbows[1] - posture.elbows[0])) == pytest.approx(more, abs=1e-15)
        assert np.hypot(*(posture.elbows[1] - (0.1, 0))) == pytest.approx(0.21, abs=1e-15)


@pytest.mark.parametrize("name", ["base.distance", "link[1].length", "link[2].length"])
def test_almost_coaxial_motors_are_degenerate(name: str) -> None:
    values = {"base.distance": 0.0} | {f"link[{i}].length": 0.1 if i in (1, 4) else 0.12 for i in range(1, 5)}
    assert Machine.from_values(values | {name: values[name] + 1e-12}).is_degenerate(ALIKE)
    assert not Machine.from_values(values | {name: values[name] + 1e-6}).is_degenerate(ALIKE)


@pytest.mark.parametrize(
    "working", [None, 3, "plus", ("plus",), ("plus", None), (["plus"], "minus"), {"plus", "minus"}]
)
def test_working_modes_that_are_none(working: object) -> None:
    for call in (HAPTIC.inverse, HAPTIC.field):
        with pytest.raises(FiveBarError, match="^working = .*(it must name two bends|it must be 'plus' or 'minus')"):
            call((0.05, 0.25), working)  # type: ignore[operator]


def test_coaxial_motors() -> None:
    """Coincident legs are singular everywhere; other postures have a ring of singularities; all is symmetric about the axis."""
    coaxial = machine(0.0, 0.10, 0.12)
    assert coaxial.is_degenerate(ALIKE) and not coaxial.is_degenerate(OUT)
    assert coaxial.dexterity(coaxial.inverse((0.05, 0.15), ALIKE).theta) == 0
    turned_by = [np.array([np.cos(angle), np.sin(angle)]) for angle in np.linspace(0, 6, 7)]
    kappas = coaxial.condition(coaxial.inverse(0.15 * np.array(turned_by), OUT).theta)
    assert np.ptp(kappas) < 1e-12 and kappas[0] < 10
    assert coaxial.reach_area == pytest.approx(np.pi * (0.22**2 - 0.02**2), rel=1e-12)
    uneven = Machine(0.0, (0.10, 0.12, 0.15, 0.08))
    assert {locus.posture for locus in uneven.direct_singularities()} == {"folded"}


def test_symmetric_tip_needs_no_lengths() -> None:
    """If both legs are bent alike below a tip on the axis of symmetry, kappa = max(y/a, a/y)."""
    for made in (PAPER, HAPTIC, DEXTAR, PANTOGRAPH):
        half = made.distance / 2
        for y in np.linspace(0.3, 0.9, 7) * np.sqrt(made.reach[0, 1] ** 2 - half**2):
            for working in (ALIKE, ("minus", "minus")):
                if made.is_reachable((half, y)):
                    assert made.condition(made.inverse((half, y), working).theta) == pytest.approx(
                        max(y / half, half / y), rel=1e-9
                    )


# Relations among the functions


def test_the_jacobian_is_the_derivative() -> None:
    for sample in samples(20, 10, seed=1):
        made = sample.machine
        posture = made.forward(sample.theta, sample.assembly)
        smooth = np.abs(sines(posture.theta)[:, 0]) > 0.05
        theta, step = sample.theta[smooth], 1e-6
        columns = [
            (
                made.forward(theta + step * side, sample.assembly).tip
                - made.forward(theta - step * side, sample.assembly).tip
            )
            / (2 * step)
            for side in np.eye(2)
        ]
        assert np.stack(columns, axis=-1) == pytest.approx(made.jacobian(posture.theta[smooth]), abs=2e-6)


def test_rates_and_forces_go_both_ways() -> None:
    for sample in samples(20, 10, seed=2):
        made, posture = sample.machine, sample.machine.forward(sample.theta, sample.assembly)
        well = np.abs(sines(posture.theta)).min(axis=-1) > 0.05
        theta, omega = posture.theta[well], sample.omega[well]
        velocity = made.tip_velocity(theta, omega)
        assert made.motor_rates(theta, velocity) == pytest.approx(omega, abs=1e-9)
        force = made.tip_force(theta, omega)
        assert made.motor_torques(theta, force) == pytest.approx(omega, abs=1e-9)
        assert np.sum(force * velocity, axis=-1) == pytest.approx(np.sum(omega * omega, axis=-1), rel=1e-9)
        singular_values = np.linalg.svd(made.jacobian(theta), compute_uv=False)
        ellipse, forces = made.velocity_ellipse(theta), made.force_ellipse(theta)
        assert ellipse.axes == pytest.approx(singular_values, rel=1e-9)
        assert forces.axes == pytest.approx(1 / singular_values[:, ::-1], rel=1e-9)
        assert made.condition(theta) == pytest.approx(singular_values[:, 0] / singular_values[:, 1], rel=1e-9)
        # Their major axes are perpendicular, and the point at the given angle is on the ellipse.
        assert np.abs(np.cos(ellipse.angle - forces.angle)).max() < 1e-6
        major = ellipse.axes[:, :1] * np.stack([np.cos(ellipse.angle), np.sin(ellipse.angle)], axis=-1)
        assert np.hypot(*made.motor_rates(theta, major).T) == pytest.approx(1.0, abs=1e-9)


def test_shapes_are_kept() -> None:
    tips = np.stack(np.meshgrid([0.15, 0.2, 0.25], [0.25, 0.3], indexing="ij"), axis=-1)
    posture = PAPER.inverse(tips)
    assert (
        posture.theta.shape == (3, 2, 4) and posture.elbows.shape == (3, 2, 2, 2) and posture.working.shape == (3, 2, 2)
    )
    assert PAPER.jacobian(posture.theta).shape == (3, 2, 2, 2) and PAPER.velocity_ellipse(
        posture.theta
    ).angle.shape == (3, 2)
    assert PAPER.inverse((0.2, 0.3)).theta.shape == (4,)
    assert PAPER.link_rates(posture.theta, (1.0, 0.0)).shape == (3, 2, 4)
    assert PAPER.inverse(np.zeros((0, 2))).theta.shape == (0, 4)


def test_the_rim_of_the_reach_is_reached() -> None:
    """On the rim, up to two bits, legs are stretched and no value is NaN."""
    for made in (PAPER, DEXTAR, PANTOGRAPH, *(sample.machine for sample in samples(20, 1, seed=5))):
        for leg in (0, 1):
            for radius in made.reach[leg]:
                angles = np.linspace(-np.pi, np.pi, 1001)
                rim = made.motors[leg] + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
                rim = rim[(made.shortfall(rim)[:, 1 - leg] == 0) & (radius > 0)]
                assert np.all(made.shortfall(rim)[:, leg] == 0)
                posture, reached = made.field(rim, OUT)
                assert reached.all() and np.isfinite(posture.theta).all()
                assert len(rim) == 0 or np.abs(sines(posture.theta)[:, 1 + leg]).max() < 1e-6
                assert np.isfinite(made.dexterity(posture.theta)).all()


# Refusals


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda: PAPER.inverse((0.9, 0.1)),
            (
                "tip = (0.9, 0.1) m is out of reach of the left leg: it is 0.9055385138 m from the leg's motor, "
                "link[1].length and link[2].length reach from 0 to 0.42 m, so that it is 0.4855 m too far."
            ),
        ),
        (
            lambda: PANTOGRAPH.inverse([(0.0125, 0.1), (0.03, 0.0)]),
            (
                "tip[1] = (0.03, 0) m is out of reach of the right leg: it is 0.005 m from "
                "the leg's motor, link[4].length and link[3].length reach from 0.012 to 0.138 m, so that it is 0.007 m too near (1 of 2 are so)."
            ),
        ),
        (
            lambda: PAPER.inverse((0.0, 0.0)),
            (
                "tip = (0, 0) m lies on the left motor's axis: the links of that leg are folded, and the angle of "
                "the motor is undetermined."
            ),
        ),
        (
            lambda: PAPER.inverse((0.21, 0.3), OUT, "minus"),
            ("tip = (0.21, 0.3) m lies in the other assembly in working mode minusPlus: it needs assembly plus."),
        ),
        (lambda: PAPER.inverse((0.21, np.nan)), "tip = (0.21, nan) m: it must be finite."),
        (lambda: PAPER.inverse((0.21, np.inf)), "tip = (0.21, inf) m: it must be finite."),
        (lambda: PAPER.inverse((0.21, 0.3, 0.0)), "tip has the shape (3,): the last axis must have 2 elements."),
        (lambda: PAPER.inverse((0.21, 0.3), ("minus", "up")), "working = 'up': it must be 'plus' or 'minus'."),
        (
            lambda: PAPER.inverse((0.21, 0.3), "minus"),
            "working = 'minus': it must name two bends, such as ('minus', 'plus'), the left leg first.",
        ),
        (
            lambda: PAPER.forward((np.pi, 0.0)),
            (
                "theta = (3.141592654, 0) rad cannot be closed: the elbows are 0.84 m apart, link[2].length and "
                "link[3].length allow 0 to 0.42 m."
            ),
        ),
        (
            lambda: PAPER.forward((0.0, np.pi)),
            (
                "theta = (0, 3.141592654) rad puts both elbows on the same point: the direction to the tip is "
                "undetermined."
            ),
        ),
        (lambda: PAPER.forward((1.0, 1.0), "left"), "assembly = 'left': it must be 'plus' or 'minus'."),
        (
            lambda: PAPER.jacobian((2.0, 0.0, np.pi, 2.0)),
            (
                "theta = (2, 0, 3.141592654, 2) rad is a singularity of the direct kind: the motors do "
                "not determine how the tip moves."
            ),
        ),
        (
            lambda: PAPER.motor_rates((1.0, 1.0, 2.0, 1.5), (0.0, 1.0)),
            (
                "theta = (1, 1, 2, 1.5) rad is a singularity of the inverse kind: no motor "
                "rate moves the tip along its leg."
            ),
        ),
        (
            lambda: Machine.from_values({"link[1].lenght": 1.0}),
            (
                "link[1].lenght is not a length of a machine; allowed are base.distance, "
                "link[1].length, link[2].length, link[3].length, link[4].length."
            ),
        ),
        (lambda: Machine.from_values({"link[3].length": 0.0}), "link[3].length = 0.0 m: it must be finite and > 0."),
        (lambda: Machine.from_values({"base.distance": -0.1}), "base.distance = -0.1 m: it must be finite and >= 0."),
    ],
)
def test_refusals(call: Callable[[], object], sentence: str) -> None:
    with pytest.raises(ValueError) as refusal:
        call()
    assert str(refusal.value) == sentence


def test_scenes_are_read(scenes: Path, tmp_path: Path) -> None:
    """Scenes are read by name and by file; the error names an unreadable file."""
    assert Machine.from_scene(scenes / "haptic.json") == HAPTIC
    assert Machine.from_scene("paper_torque") == PAPER
    with pytest.raises(ValueError, match="there is no scene 'nonsense'; there are .*haptic"):
        Machine.from_scene("nonsense")
    (tmp_path / "raw.json").write_text(json.dumps({"base.distance": 1}), encoding="utf-8")
    with pytest.raises(ValueError, match="raw.json: it has no text 'description'"):
        Machine.from_scene(tmp_path / "raw.json")
    with pytest.raises(ValueError, match="nothing.json: it cannot be read: No such file or directory"):
        Machine.from_scene(tmp_path / "nothing.json")


def test_the_least_sine_is_that_of_the_unit() -> None:
    source = (REPOSITORY / "src" / "mechanism" / "closure.rs").read_text(encoding="utf-8")
    assert f"const LEAST_SINE: f64 = {LEAST_SINE:.0e};".replace("e-08", "e-8") in source
